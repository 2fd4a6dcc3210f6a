"""Open what a function needs: the service, the controller, and the object whose handle the function takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

from bcapscope.client.controller_target import DEFAULT_ROBOT, ROBSLAVE, ControllerTarget
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.client.remote_object import RemoteObject, first_variant, handle_of, required_variant
from bcapscope.client.remote_objects import Controller, Robot
from bcapscope.client.session import Session
from bcapscope.errors import ControllerError
from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.tables.variables import find_variable

R = TypeVar("R", bound=RemoteObject)

DEFAULT_OBJECT_NAMES: Mapping[ObjectClass, str] = {
    ObjectClass.ROBOT: DEFAULT_ROBOT,
    ObjectClass.TASK: ROBSLAVE,
}
"""For a class of objects, the name with which most controllers open an object of this class."""


_UNKNOWN_PROVIDER_CODES = (E_INVALIDARG, 0x80000201)
"""RC8 and the CAO engine refuse a provider with these codes (orin_bcap C/include/bcap_common.h)."""


class ObjectOpener:
    """Opens the objects that a call needs, unless earlier calls of the session have opened them.

    Every method raises the exceptions of `Session.call`.
    """

    def __init__(
        self,
        session: Session,
        target: ControllerTarget,
        names: Mapping[ObjectClass, str] = DEFAULT_OBJECT_NAMES,
    ) -> None:
        """Send nothing to `target` yet. `names` replaces names in `DEFAULT_OBJECT_NAMES`."""
        self.session = session
        self._target = target
        self._names = {**DEFAULT_OBJECT_NAMES, **names}

    async def handle_for(self, object_class: ObjectClass) -> int:
        """Return the handle of the newest open object of a class; if none is open, open one.

        Raises ValueError if an object of the class can only be opened by name, and no name is known.
        """
        found = self.session.handles.latest(object_class)
        if found is not None:
            return found.handle
        if object_class is ObjectClass.CONTROLLER:
            return await self._open_controller()
        if object_class is ObjectClass.MESSAGE:
            controller = await self.handle_for(ObjectClass.CONTROLLER)
            return handle_of(await self.session.invoke("Controller_GetMessage", controller))
        return await self._open_named(object_class)

    async def open_remote(self, kind: type[R]) -> R:
        return kind(self.session, await self.handle_for(kind.owner))

    async def start_service(self) -> None:
        if not self.session.handles.is_service_started:
            await self.session.invoke("Service_Start", self._target.service)

    async def connect_controller(self, providers: Sequence[str]) -> str:
        """Connect with the first of `providers` that the controller knows, and return this provider."""
        for provider in providers[:-1]:
            try:
                await self._connect_with(provider)
            except ControllerError as error:
                if error.hresult not in _UNKNOWN_PROVIDER_CODES:
                    raise
            else:
                return provider
        await self._connect_with(providers[-1])
        return providers[-1]

    async def open_child(self, parent: ObjectHandle, kind: ObjectClass, name: str) -> int:
        found = self.session.handles.find_named(kind, name, parent)
        if found is not None:
            return found.handle
        return handle_of(await self.session.invoke(f"{parent.kind}_Get{kind}", parent.handle, name, ""))

    async def read_variable(self, owner: ObjectClass, name: str) -> Variant:
        """Read a variable of the newest open object whose class is `owner`. The variable stays open."""
        parent = self.session.handles.find(owner, await self.handle_for(owner))
        assert parent is not None  # `handle_for` has recorded the object in `handles`
        variable = await self.open_child(parent, ObjectClass.VARIABLE, name)
        return required_variant(await self.session.invoke("Variable_GetValue", variable), name)

    async def is_simulator(self) -> bool:
        value = await read_variable_once(await self.open_remote(Controller), SIMULATOR_VARIABLE)
        return value is not None and value.value == SIMULATOR_TEXT

    async def _open_controller(self) -> int:
        await self.start_service()
        try:
            return await self._connect_with(self._target.provider)
        except ControllerError as error:
            if error.hresult != E_INVALIDARG:
                raise
            # The providers: ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2
            # denso_robot_core (RC8), nkawa/Denso_CobottaPro900_MQTT_Control (VRC9).
            meaning = Message("call.refused.provider", meaning=error.meaning)
            raise ControllerError("Controller_Connect", error.hresult, error.name, meaning) from error

    async def _connect_with(self, provider: str) -> int:
        arguments = replace(self._target, provider=provider).connect
        return handle_of(await self.session.invoke("Controller_Connect", *arguments))

    async def _open_named(self, object_class: ObjectClass) -> int:
        name = self._names.get(object_class)
        if name is None:
            raise ValueError(f"the {object_class} has no known name; pass its name, or open it first")
        is_variable = object_class is ObjectClass.VARIABLE
        owners = (ObjectClass.CONTROLLER, ObjectClass.ROBOT, ObjectClass.TASK) if is_variable else ()
        parent = next((owner for owner in owners if find_variable(owner, name)), ObjectClass.CONTROLLER)
        return handle_of(
            await self.session.invoke(f"{parent}_Get{object_class}", await self.handle_for(parent), name, "")
        )


async def read_variable_once(owner: Controller | Robot, name: str) -> Variant | None:
    """Open, read and release a variable. Return None after a refusal, and EMPTY if the reply has no value."""
    try:
        variable = await owner.get_variable(name)
    except ControllerError:
        return None
    try:
        reply = await owner.session.invoke("Variable_GetValue", variable.handle)
        value = first_variant(reply) or EMPTY
    except ControllerError:
        value = None
    with suppress(ControllerError):
        await variable.release()
    return value
