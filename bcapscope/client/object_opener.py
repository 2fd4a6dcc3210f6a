"""Open what a function needs: the service, the controller, and the object whose handle it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bcapscope.client.session import Session
from bcapscope.client.variant_values import arguments_of
from bcapscope.errors import ControllerError
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import CallAnswered, RequesterOutcome
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.tables.variables import find_variable
from bcapscope.traffic.handle_table import HandleTable

DEFAULT_OBJECT_NAMES: Mapping[ObjectClass, str] = {ObjectClass.ROBOT: "Arm", ObjectClass.TASK: "RobSlave"}
"""Names of objects that most controllers have."""

PROVIDER_ADVICE = (
    "RC8 and COBOTTA want the provider CaoProv.DENSO.VRC, RC9 and COBOTTA PRO want CaoProv.DENSO.VRC9"
)
"""Advice when the controller refuses Controller_Connect. Sources: ShoheiKobata/orin_bcap_python_samples,
DENSORobot/denso_robot_ros2 denso_robot_core (RC8), nkawa/Denso_CobottaPro900_MQTT_Control (VRC9)."""


class ObjectOpener:
    """Opens missing objects before a call, and uses those that earlier calls opened.

    Attributes:
        session: Session that makes the calls.
    """

    def __init__(
        self, session: Session, service: str, connect: Sequence[str], names: Mapping[ObjectClass, str]
    ) -> None:
        """Set how to open objects; nothing is sent yet.

        Args:
            session: Session in which nothing is open yet.
            service: Option of Service_Start.
            connect: The four arguments of Controller_Connect.
            names: Names of the objects to open, if different from `DEFAULT_OBJECT_NAMES`.
        """
        self.session = session
        self._service_option = service
        self._connect_arguments = connect
        self._names = {**DEFAULT_OBJECT_NAMES, **names}
        self._started = False
        self._handles: dict[ObjectClass, int] = {}
        self._handle_table = HandleTable()

    async def handle_for(self, object_class: ObjectClass) -> int:
        """Return the handle of the latest object of this class; open one if there is none.

        Raises:
            ValueError: Opening needs a name, and none is known.
            BcapError: A call failed, as for `Session.call`.
        """
        if object_class not in self._handles:
            if object_class is ObjectClass.CONTROLLER:
                await self.start_service()
                await self._connect_controller()
            elif object_class is ObjectClass.MESSAGE:
                await self.invoke("Controller_GetMessage", await self.handle_for(ObjectClass.CONTROLLER))
            else:
                await self._open_object(object_class)
        return self._handles[object_class]

    async def start_service(self) -> None:
        """Start the service, if it is not started yet."""
        if not self._started:
            await self.invoke("Service_Start", self._service_option)

    async def perform_call(self, function: Function, arguments: Sequence[Variant]) -> RequesterOutcome:
        """Make a call with ready-made arguments, and record the handle that it opens or releases."""
        settled = await self.session.perform_call(function.id, arguments)
        if isinstance(settled, CallAnswered):
            self._record_call(function, arguments, settled)
        return settled

    async def invoke(self, name: str, *values: object) -> object:
        """Make a call with Python values, and record handles as `perform_call` does; return the value in the
        reply."""
        reply = await self.session.invoke(name, *values)
        function = next(one for one in FUNCTIONS.values() if one.name == name)
        self._record_call(function, arguments_of(function, values), CallAnswered(reply, ()))
        return reply.arguments[0].variant.value if reply.arguments else None

    def variable_name(self, arguments: Sequence[Variant]) -> str:
        """Return the name of the variable in the first argument; "" if it was not opened here."""
        handle = arguments[0].value if arguments else None
        opened = self._handle_table.find(ObjectClass.VARIABLE, handle) if isinstance(handle, int) else None
        return opened.label if opened is not None else ""

    async def is_simulator(self) -> bool:
        """Ask whether the controller is bcapscope's simulator; no real controller gives the same answer."""
        controller = await self.handle_for(ObjectClass.CONTROLLER)
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
            await self.invoke("Controller_Connect", *self._connect_arguments)
        except ControllerError as error:
            if error.hresult != E_INVALIDARG:
                raise
            meaning = f"{error.meaning}; {PROVIDER_ADVICE}"
            raise ControllerError("Controller_Connect", error.hresult, error.name, meaning) from error

    async def _open_object(self, object_class: ObjectClass) -> None:
        name = self._names.get(object_class)
        if name is None:
            raise ValueError(f"which {object_class}? Give its name, or open it before")
        parent = ObjectClass.CONTROLLER
        if object_class is ObjectClass.VARIABLE and find_variable(ObjectClass.CONTROLLER, name) is None:
            others = (ObjectClass.ROBOT, ObjectClass.TASK)
            parent = next((other for other in others if find_variable(other, name)), parent)
        await self.invoke(f"{parent}_Get{object_class}", await self.handle_for(parent), name, "")

    def _record_call(self, function: Function, arguments: Sequence[Variant], settled: CallAnswered) -> None:
        self._handle_table.record_call(function, arguments, settled.reply)
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
