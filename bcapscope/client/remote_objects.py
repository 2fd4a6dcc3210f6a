"""The objects of a controller, with each b-CAP function as a method.

Each method is named after the function that it calls: `Robot.get_attribute` calls Robot_GetAttribute.
`protocol.tables.function_table` lists the types and the order of the arguments. Every method raises the
exceptions of `Session.call`. If the value in a reply has a wrong type, the method raises RemoteProtocolError.
Dates are in the controller's time zone.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any, TypeVar

from bcapscope.client.caller import EventListener, Observer
from bcapscope.client.controller_target import DEFAULT_RETRY_POLICIES, RetryPolicies
from bcapscope.client.remote_object import RemoteObject, expect_value, handle_of
from bcapscope.client.session import LinkOpener, Session, open_session
from bcapscope.protocol.codec.variant import VT, Value, Variant
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.function_table import ObjectClass

R = TypeVar("R")

PTP = 1
"""PTP interpolation of Robot_Move: each axis moves directly to its target."""

ONE_CYCLE = 1
"""Mode of Task_Start."""


def _getter(
    invoke: Callable[[RemoteObject, str], Coroutine[Any, Any, R]], verb: str
) -> Callable[[RemoteObject], Coroutine[Any, Any, R]]:
    """Return a method that calls a b-CAP function which takes only the handle."""

    async def get(self: RemoteObject) -> R:
        return await invoke(self, verb)

    return get


class _DescribedObject(RemoteObject):
    """Functions that all classes of objects have, except ControllerMessage."""

    get_attribute = _getter(RemoteObject._invoke_int, "GetAttribute")  # bits
    get_help = _getter(RemoteObject._invoke_text, "GetHelp")
    get_name = _getter(RemoteObject._invoke_text, "GetName")
    get_tag = _getter(RemoteObject._invoke_value, "GetTag")  # value stored with `put_tag`

    async def put_tag(self, value: object) -> None:
        """Store a value in the object. `get_tag` returns this value."""
        await self._invoke("PutTag", value)

    get_id = _getter(RemoteObject._invoke_value, "GetID")

    async def put_id(self, value: object) -> None:
        await self._invoke("PutID", value)


class _ObjectWithVariables(RemoteObject):
    async def get_variable(self, name: str, option: str = "") -> Variable:
        """Open a variable, such as ``@CURRENT_ANGLE`` of a robot or ``I1`` of a controller."""
        return Variable(self.session, await self._invoke_handle("GetVariable", name, option))

    async def get_variable_names(self, option: str = "") -> tuple[str, ...]:
        return await self._invoke_names("GetVariableNames", option)


class _ExecutingObject(RemoteObject):
    async def execute(self, command: str, param: object = None) -> Value:
        """Execute a command. If `param` is a Variant, it is sent with its own type; `variant_of` converts any
        other value.
        """
        return await self._invoke_value("Execute", command, param)


class Controller(_DescribedObject, _ObjectWithVariables, _ExecutingObject):
    """A controller."""

    owner = ObjectClass.CONTROLLER

    async def release(self) -> None:
        """Call Controller_Disconnect. When the session's block ends, the session disconnects
        automatically.
        """
        await self._invoke("Disconnect")

    async def get_extension(self, name: str, option: str = "") -> Extension:
        """Open an extension, such as ``Hand0``."""
        return Extension(self.session, await self._invoke_handle("GetExtension", name, option))

    async def get_file(self, name: str, option: str = "") -> File:
        """Open a file. The option ``@Create=1`` creates the file."""
        return File(self.session, await self._invoke_handle("GetFile", name, option))

    async def get_robot(self, name: str, option: str = "") -> Robot:
        """Open a robot, usually ``Arm``."""
        return Robot(self.session, await self._invoke_handle("GetRobot", name, option))

    async def get_task(self, name: str, option: str = "") -> Task:
        """Open a task, such as ``RobSlave``."""
        return Task(self.session, await self._invoke_handle("GetTask", name, option))

    async def get_command(self, name: str, option: str = "") -> Command:
        return Command(self.session, await self._invoke_handle("GetCommand", name, option))

    async def get_message(self) -> ControllerMessage:
        """Open the next message."""
        return ControllerMessage(self.session, await self._invoke_handle("GetMessage"))

    async def get_extension_names(self, option: str = "") -> tuple[str, ...]:
        return await self._invoke_names("GetExtensionNames", option)

    async def get_file_names(self, option: str = "") -> tuple[str, ...]:
        return await self._invoke_names("GetFileNames", option)

    async def get_robot_names(self, option: str = "") -> tuple[str, ...]:
        return await self._invoke_names("GetRobotNames", option)

    async def get_task_names(self, option: str = "") -> tuple[str, ...]:
        return await self._invoke_names("GetTaskNames", option)

    async def get_command_names(self, option: str = "") -> tuple[str, ...]:
        return await self._invoke_names("GetCommandNames", option)


class Extension(_DescribedObject, _ObjectWithVariables, _ExecutingObject):
    """An extension of the controller, such as a hand, a serial line or a pallet."""

    owner = ObjectClass.EXTENSION


class File(_DescribedObject, _ObjectWithVariables, _ExecutingObject):
    """A file or folder."""

    owner = ObjectClass.FILE

    async def get_file(self, name: str, option: str = "") -> File:
        """Open a file in this folder. The File object must refer to a folder."""
        return File(self.session, await self._invoke_handle("GetFile", name, option))

    async def get_file_names(self, option: str = "") -> tuple[str, ...]:
        """List the names of the files in this folder. The File object must refer to a folder."""
        return await self._invoke_names("GetFileNames", option)

    async def copy(self, name: str, option: str = "") -> None:
        """Copy the file to `name`."""
        await self._invoke("Copy", name, option)

    async def delete(self, option: str = "") -> None:
        await self._invoke("Delete", option)

    async def move(self, name: str, option: str = "") -> None:
        """Move the file to `name`."""
        await self._invoke("Move", name, option)

    async def run(self, option: str = "") -> str:
        """Run this file as a program; return the name that the controller gives the running program."""
        return await self._invoke_text("Run", option)

    get_date_created = _getter(RemoteObject._invoke_date, "GetDateCreated")
    get_date_last_accessed = _getter(RemoteObject._invoke_date, "GetDateLastAccessed")
    get_date_last_modified = _getter(RemoteObject._invoke_date, "GetDateLastModified")
    get_path = _getter(RemoteObject._invoke_text, "GetPath")
    get_size = _getter(RemoteObject._invoke_int, "GetSize")  # bytes
    get_type = _getter(RemoteObject._invoke_text, "GetType")
    get_value = _getter(RemoteObject._invoke_value, "GetValue")

    async def put_value(self, value: object) -> None:
        """Write the contents."""
        await self._invoke("PutValue", value)


class Robot(_DescribedObject, _ObjectWithVariables, _ExecutingObject):
    """A robot arm. Many of these methods move the robot."""

    owner = ObjectClass.ROBOT

    async def accelerate(self, axis: int, accel: float, decel: float) -> None:
        """Set the internal acceleration and deceleration in percent. Axis -1 means the tool tip."""
        await self._invoke("Accelerate", axis, accel, decel)

    async def change(self, name: str) -> None:
        """Select a tool or work coordinate system, such as ``Tool1``."""
        await self._invoke("Change", name)

    async def chuck(self, option: str = "") -> None:
        """Close the hand."""
        await self._invoke("Chuck", option)

    async def drive(self, axis: int, distance: float, option: str = "") -> None:
        """Move one axis by a distance in degrees or mm."""
        await self._invoke("Drive", axis, distance, option)

    async def go_home(self) -> None:
        await self._invoke("GoHome")

    async def halt(self, option: str = "") -> None:
        """Stop the motion at once. A motion that was halted cannot be resumed."""
        await self._invoke("Halt", option)

    async def hold(self, option: str = "") -> None:
        """Stop the motion; `unhold` resumes it."""
        await self._invoke("Hold", option)

    async def move(self, interpolation: int, pose: object, option: str = "") -> None:
        """Move to a pose such as ``@E J(0,0,90)``; interpolation 1 is PTP, 2 line, 3 arc, 4 free curve."""
        await self._invoke("Move", interpolation, pose, option)

    async def rotate(self, plane: object, angle: float, pivot: object, option: str = "") -> None:
        """Rotate around an axis by an angle in degrees."""
        await self._invoke("Rotate", plane, angle, pivot, option)

    async def speed(self, axis: int, speed: float) -> None:
        """Set the internal speed in percent. Axis -1 means the tool tip."""
        await self._invoke("Speed", axis, speed)

    async def unchuck(self, option: str = "") -> None:
        """Open the hand."""
        await self._invoke("Unchuck", option)

    async def unhold(self, option: str = "") -> None:
        """Resume a motion that `hold` stopped."""
        await self._invoke("Unhold", option)

    async def slv_change_mode(self, mode: int) -> None:
        """Enter the slave mode `mode`. Mode 0 leaves slave mode. When the session's block ends, the session
        leaves slave mode automatically.
        """
        await self.execute("slvChangeMode", Variant(VT.I4, mode))

    async def slv_get_mode(self) -> int:
        return expect_value(await self._invoke("Execute", "slvGetMode", None), int, "reply.a-mode")

    async def slv_move(self, point: object) -> Value:
        """Send a set point and return the position of the robot. A list is sent as an array of R8; a Variant
        is sent with its own type.
        """
        return await self._invoke_value("Execute", "slvMove", point)


class Task(_DescribedObject, _ObjectWithVariables, _ExecutingObject):
    """A program on the controller."""

    owner = ObjectClass.TASK

    async def start(self, mode: int, option: str = "") -> None:
        """Start the task. Values of `mode`: 1 = one cycle, 2 = repeat, 3 = one step."""
        await self._invoke("Start", mode, option)

    async def stop(self, mode: int, option: str = "") -> None:
        """Stop the task.

        Values of `mode`: 0 = default, 1 = immediately, 2 = after the step, 3 = after the cycle, 4 =
        initialise.
        """
        await self._invoke("Stop", mode, option)

    async def delete(self, option: str = "") -> None:
        await self._invoke("Delete", option)

    get_file_name = _getter(RemoteObject._invoke_text, "GetFileName")


class Variable(_DescribedObject):
    """A variable."""

    owner = ObjectClass.VARIABLE

    get_value = _getter(RemoteObject._invoke_value, "GetValue")

    async def put_value(self, value: object) -> None:
        """Write the value. A value of the class Variant is sent with its own type; `variant_of` converts all
        other values.
        """
        await self._invoke("PutValue", value)

    get_date_time = _getter(RemoteObject._invoke_date, "GetDateTime")
    get_microsecond = _getter(RemoteObject._invoke_int, "GetMicrosecond")  # of that date


class Command(_DescribedObject):
    """A stored command."""

    owner = ObjectClass.COMMAND

    async def execute(self, mode: int) -> Value:
        """Execute the command. With some controllers, the reply has a value."""
        return await self._invoke_value("Execute", mode)

    async def cancel(self) -> None:
        await self._invoke("Cancel")

    get_timeout = _getter(RemoteObject._invoke_int, "GetTimeout")  # ms

    async def put_timeout(self, value: int) -> None:
        """Set the timeout in ms."""
        await self._invoke("PutTimeout", value)

    get_state = _getter(RemoteObject._invoke_int, "GetState")
    get_parameters = _getter(RemoteObject._invoke_value, "GetParameters")

    async def put_parameters(self, value: object) -> None:
        await self._invoke("PutParameters", value)

    get_result = _getter(RemoteObject._invoke_value, "GetResult")


class ControllerMessage(RemoteObject):
    """A message from the controller."""

    owner = ObjectClass.MESSAGE

    async def reply(self, data: object) -> None:
        await self._invoke("Reply", data)

    async def clear(self) -> None:
        await self._invoke("Clear")

    get_date_time = _getter(RemoteObject._invoke_date, "GetDateTime")
    get_description = _getter(RemoteObject._invoke_text, "GetDescription")  # the text
    get_destination = _getter(RemoteObject._invoke_text, "GetDestination")  # the receiver
    get_number = _getter(RemoteObject._invoke_int, "GetNumber")
    get_serial_number = _getter(RemoteObject._invoke_int, "GetSerialNumber")
    get_source = _getter(RemoteObject._invoke_text, "GetSource")  # the sender
    get_value = _getter(RemoteObject._invoke_value, "GetValue")


class Service:
    """The b-CAP service of a controller."""

    def __init__(self, session: Session) -> None:
        self.session = session

    async def start(self, option: str = "") -> None:
        """Call Service_Start. The option ``,WDT=400`` requests a notice every 400 ms during a long call."""
        await self.session.invoke("Service_Start", option)

    async def stop(self) -> None:
        """Call Service_Stop. At the end of its block, the session stops the service automatically."""
        await self.session.invoke("Service_Stop")

    async def connect(
        self, name: str = "", provider: str = "", machine: str = "", option: str = ""
    ) -> Controller:
        """Call Controller_Connect. RC7 ignores all four arguments; RC8 and later need the provider.

        The provider is ``CaoProv.DENSO.VRC``, or ``CaoProv.DENSO.VRC9`` on RC9 and COBOTTA PRO; the machine
        is ``localhost``. If the name is empty, the controller chooses one. An example of an option is
        ``@IfNotMember``.
        """
        reply = await self.session.invoke("Controller_Connect", name, provider, machine, option)
        return Controller(self.session, handle_of(reply))


@asynccontextmanager
async def connect(
    open_link: LinkOpener,
    option: str = "",
    *,
    convention: ReservedConvention | None = None,
    retry_policies: RetryPolicies = DEFAULT_RETRY_POLICIES,
    observer: Observer | None = None,
    listener: EventListener | None = None,
) -> AsyncIterator[Service]:
    """Open a session as `open_session` does, and start the service with `option`."""
    async with open_session(
        open_link, convention=convention, retry_policies=retry_policies, observer=observer, listener=listener
    ) as session:
        service = Service(session)
        await service.start(option)
        yield service
