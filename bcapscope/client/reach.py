"""Making the connections that a function needs: service, controller, and the object whose handle it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bcapscope.client.session import Session
from bcapscope.client.values import arguments_of
from bcapscope.errors import ControllerError
from bcapscope.protocol.functions import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.hresult import E_INVALIDARG
from bcapscope.protocol.requester import Answered, Settled
from bcapscope.protocol.simulated import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.variables import variable
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.opened import Book

NAMES: Mapping[ObjectClass, str] = {ObjectClass.ROBOT: "Arm", ObjectClass.TASK: "RobSlave"}
"""Names of objects that most controllers have."""

PROVIDERS = "RC8 and COBOTTA want the provider CaoProv.DENSO.VRC, RC9 and COBOTTA PRO want CaoProv.DENSO.VRC9"
"""What to do about a Controller_Connect that is refused: ShoheiKobata/orin_bcap_python_samples,
DENSORobot/denso_robot_ros2 denso_robot_core (RC8), nkawa/Denso_CobottaPro900_MQTT_Control (VRC9)."""


class Reach:
    """Opens what is missing before a call, and uses what earlier calls have opened.

    Attributes:
        session: whose calls these are.
    """

    def __init__(
        self, session: Session, service: str, connect: Sequence[str], names: Mapping[ObjectClass, str]
    ) -> None:
        """Say how to open things.

        Args:
            session: nothing is open in it yet.
            service: option of Service_Start.
            connect: the four arguments of Controller_Connect.
            names: of the objects to open, where `NAMES` will not do.
        """
        self.session = session
        self._service = service
        self._connect = connect
        self._names = {**NAMES, **names}
        self._started = False
        self._handles: dict[ObjectClass, int] = {}
        self._book = Book()

    async def handle(self, owner: ObjectClass) -> int:
        """Return the handle of what was opened last of this class; open one where there is none.

        Raises:
            ValueError: it has to be opened by a name, and none is known.
            BcapError: as `Session.call`.
        """
        if owner not in self._handles:
            if owner is ObjectClass.CONTROLLER:
                await self.start()
                await self._connect_controller()
            elif owner is ObjectClass.MESSAGE:
                await self.invoke("Controller_GetMessage", await self.handle(ObjectClass.CONTROLLER))
            else:
                await self._get(owner)
        return self._handles[owner]

    async def start(self) -> None:
        """Start the service, unless that was done."""
        if not self._started:
            await self.invoke("Service_Start", self._service)

    async def exchange(self, function: Function, arguments: Sequence[Variant]) -> Settled:
        """Make a call as it is, and remember the handle that it opens or releases."""
        settled = await self.session.exchange(function.id, arguments)
        if isinstance(settled, Answered):
            self._note(function, arguments, settled)
        return settled

    async def invoke(self, name: str, *values: object) -> object:
        """Make a call with Python values, and remember as `exchange`; return the value of the answer."""
        reply = await self.session.invoke(name, *values)
        function = next(one for one in FUNCTIONS.values() if one.name == name)
        self._note(function, arguments_of(function, values), Answered(reply, ()))
        return reply.arguments[0].variant.value if reply.arguments else None

    def variable_named(self, arguments: Sequence[Variant]) -> str:
        """Return the name of the variable whose handle stands first; "" if it was not opened here."""
        handle = arguments[0].value if arguments else None
        opened = self._book.find(ObjectClass.VARIABLE, handle) if isinstance(handle, int) else None
        return opened.label if opened is not None else ""

    async def meets_simulator(self) -> bool:
        """Ask the peer whether it is our simulator, which no real controller says."""
        controller = await self.handle(ObjectClass.CONTROLLER)
        try:
            reply = await self.session.invoke("Controller_GetVariable", controller, SIMULATOR_VARIABLE, "")
            handle = reply.arguments[0].variant.value if reply.arguments else None
            value = await self.session.invoke("Variable_GetValue", handle)
            await self.session.invoke("Variable_Release", handle)
        except ControllerError:
            return False
        return bool(value.arguments) and value.arguments[0].variant.value == SIMULATOR_TEXT

    async def _connect_controller(self) -> None:
        try:
            await self.invoke("Controller_Connect", *self._connect)
        except ControllerError as error:
            if error.hresult != E_INVALIDARG:
                raise
            meaning = f"{error.meaning}; {PROVIDERS}"
            raise ControllerError("Controller_Connect", error.hresult, error.name, meaning) from error

    async def _get(self, owner: ObjectClass) -> None:
        name = self._names.get(owner)
        if name is None:
            raise ValueError(f"which {owner}? Give its name, or open it before")
        parent = ObjectClass.CONTROLLER
        if owner is ObjectClass.VARIABLE and variable(ObjectClass.CONTROLLER, name) is None:
            others = (ObjectClass.ROBOT, ObjectClass.TASK)
            parent = next((other for other in others if variable(other, name)), parent)
        await self.invoke(f"{parent}_Get{owner}", await self.handle(parent), name, "")

    def _note(self, function: Function, arguments: Sequence[Variant], settled: Answered) -> None:
        self._book.note(function, arguments, settled.reply)
        if function.creates is ObjectClass.SERVICE:
            self._started = True
        elif function.creates is not None:
            value = settled.reply.arguments[0].variant.value if settled.reply.arguments else None
            if isinstance(value, int):
                self._handles[function.creates] = value
        if function.releases is ObjectClass.SERVICE:
            self._started = False
            self._handles.clear()
        elif function.releases is not None:
            released = arguments[0].value if arguments else None
            if self._handles.get(function.releases) == released:
                self._handles.pop(function.releases, None)
