"""The objects of a controller, each function of b-CAP a method.

A method is its vendor's name in small letters; the class it belongs to completes the name of the function, so
that `Robot.get_attribute` calls Robot_GetAttribute. Types and order of the arguments are those of
`protocol.functions`. Every method raises what `Session.call` raises, and RemoteProtocolError where the answer
is of a type that the function does not have.
"""

from __future__ import annotations

from datetime import datetime
from types import TracebackType
from typing import ClassVar, Self, TypeVar

from bcapscope.client.session import Session
from bcapscope.client.values import date_of, plain
from bcapscope.errors import RemoteProtocolError
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.variant import VT, Value, Variant, vt_name

R = TypeVar("R")


def handle_of(reply: Frame) -> int:
    """Read the handle out of the reply to a call that opened something.

    Raises:
        RemoteProtocolError: there is none.
    """
    return _result(reply, int, "a handle")


def _first(reply: Frame) -> Variant | None:
    arguments = reply.arguments
    return arguments[0].variant if arguments else None


def _result(reply: Frame, kind: type[R], wanted: str) -> R:
    variant = _first(reply)
    if variant is not None and isinstance(variant.value, kind):
        return variant.value
    found = "nothing" if variant is None else vt_name(variant.vt)
    raise RemoteProtocolError(f"the answer holds {found} instead of {wanted}", reply.raw)


class Remote:
    """Something in the controller that a handle stands for; `async with` releases it at the end."""

    owner: ClassVar[ObjectClass]

    def __init__(self, session: Session, handle: int) -> None:
        self.session = session
        self.handle = handle

    async def release(self) -> None:
        """Let go of it; done by itself at the end of the session's block."""
        await self._do("Release")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.release()

    async def _do(self, verb: str, *values: object) -> Frame:
        return await self.session.invoke(f"{self.owner}_{verb}", self.handle, *values)

    async def _number(self, verb: str) -> int:
        return _result(await self._do(verb), int, "a number")

    async def _text(self, verb: str, *values: object) -> str:
        return _result(await self._do(verb, *values), str, "a string")

    async def _value(self, verb: str, *values: object) -> Value:
        variant = _first(await self._do(verb, *values))
        return None if variant is None else plain(variant)

    async def _names(self, verb: str, option: str) -> tuple[str, ...]:
        reply = await self._do(verb, option)
        variant = _first(reply)
        names = None if variant is None else plain(variant)
        if names is None:
            return ()
        if isinstance(names, tuple):
            texts = tuple(name for name in names if isinstance(name, str))
            if len(texts) == len(names):
                return texts
        raise RemoteProtocolError("the answer holds no list of names", reply.raw)

    async def _date(self, verb: str) -> datetime:
        reply = await self._do(verb)
        days = _result(reply, float, "a date")
        date = date_of(days)
        if date is None:
            raise RemoteProtocolError(f"the answer holds a date that no calendar has, {days} days", reply.raw)
        return date

    async def _opened(self, verb: str, *values: object) -> int:
        return handle_of(await self._do(verb, *values))


class _Described(Remote):
    """What all classes but Message have."""

    async def get_attribute(self) -> int:
        """Return the attribute bits."""
        return await self._number("GetAttribute")

    async def get_help(self) -> str:
        """Return the help text."""
        return await self._text("GetHelp")

    async def get_name(self) -> str:
        """Return the name."""
        return await self._text("GetName")

    async def get_tag(self) -> Value:
        """Return what a client has put there for itself."""
        return await self._value("GetTag")

    async def put_tag(self, value: object) -> None:
        """Put something there for oneself."""
        await self._do("PutTag", value)

    async def get_id(self) -> Value:
        """Return the ID."""
        return await self._value("GetID")

    async def put_id(self, value: object) -> None:
        """Set the ID."""
        await self._do("PutID", value)


class _WithVariables(Remote):
    """What has variables of its own."""

    async def get_variable(self, name: str, option: str = "") -> Variable:
        """Open a variable, such as ``@CURRENT_ANGLE`` of a robot or ``I1`` of a controller."""
        return Variable(self.session, await self._opened("GetVariable", name, option))

    async def get_variable_names(self, option: str = "") -> tuple[str, ...]:
        """List the variables."""
        return await self._names("GetVariableNames", option)


class _Executing(Remote):
    """What takes commands."""

    async def execute(self, command: str, param: object = None) -> Value:
        """Execute a command; a Variant as `param` chooses the type, other values get one (`variant_of`)."""
        return await self._value("Execute", command, param)


class Controller(_Described, _WithVariables, _Executing):
    """A controller."""

    owner = ObjectClass.CONTROLLER

    async def release(self) -> None:
        """Controller_Disconnect; done by itself at the end of the session's block."""
        await self._do("Disconnect")

    async def get_extension(self, name: str, option: str = "") -> Extension:
        """Open an extension, such as ``Hand0``."""
        return Extension(self.session, await self._opened("GetExtension", name, option))

    async def get_file(self, name: str, option: str = "") -> File:
        """Open a file; option ``@Create=1`` creates it."""
        return File(self.session, await self._opened("GetFile", name, option))

    async def get_robot(self, name: str, option: str = "") -> Robot:
        """Open a robot, usually ``Arm``."""
        return Robot(self.session, await self._opened("GetRobot", name, option))

    async def get_task(self, name: str, option: str = "") -> Task:
        """Open a task, such as ``RobSlave``."""
        return Task(self.session, await self._opened("GetTask", name, option))

    async def get_command(self, name: str, option: str = "") -> Command:
        """Open a command."""
        return Command(self.session, await self._opened("GetCommand", name, option))

    async def get_message(self) -> Message:
        """Open the next message."""
        return Message(self.session, await self._opened("GetMessage"))

    async def get_extension_names(self, option: str = "") -> tuple[str, ...]:
        """List the extensions."""
        return await self._names("GetExtensionNames", option)

    async def get_file_names(self, option: str = "") -> tuple[str, ...]:
        """List the files."""
        return await self._names("GetFileNames", option)

    async def get_robot_names(self, option: str = "") -> tuple[str, ...]:
        """List the robots."""
        return await self._names("GetRobotNames", option)

    async def get_task_names(self, option: str = "") -> tuple[str, ...]:
        """List the tasks."""
        return await self._names("GetTaskNames", option)

    async def get_command_names(self, option: str = "") -> tuple[str, ...]:
        """List the commands."""
        return await self._names("GetCommandNames", option)


class Extension(_Described, _WithVariables, _Executing):
    """An extension: a hand, a line, a pallet."""

    owner = ObjectClass.EXTENSION


class File(_Described, _WithVariables, _Executing):
    """A file or folder."""

    owner = ObjectClass.FILE

    async def get_file(self, name: str, option: str = "") -> File:
        """Open a file in this folder."""
        return File(self.session, await self._opened("GetFile", name, option))

    async def get_file_names(self, option: str = "") -> tuple[str, ...]:
        """List the files in this folder."""
        return await self._names("GetFileNames", option)

    async def copy(self, name: str, option: str = "") -> None:
        """Copy it to `name`."""
        await self._do("Copy", name, option)

    async def delete(self, option: str = "") -> None:
        """Delete it."""
        await self._do("Delete", option)

    async def move(self, name: str, option: str = "") -> None:
        """Move it to `name`."""
        await self._do("Move", name, option)

    async def run(self, option: str = "") -> str:
        """Run it; return the name of what runs."""
        return await self._text("Run", option)

    async def get_date_created(self) -> datetime:
        """Return when it was created, in the controller's time."""
        return await self._date("GetDateCreated")

    async def get_date_last_accessed(self) -> datetime:
        """Return when it was read last, in the controller's time."""
        return await self._date("GetDateLastAccessed")

    async def get_date_last_modified(self) -> datetime:
        """Return when it was written last, in the controller's time."""
        return await self._date("GetDateLastModified")

    async def get_path(self) -> str:
        """Return its path."""
        return await self._text("GetPath")

    async def get_size(self) -> int:
        """Return its size in bytes."""
        return await self._number("GetSize")

    async def get_type(self) -> str:
        """Return its type."""
        return await self._text("GetType")

    async def get_value(self) -> Value:
        """Return its contents."""
        return await self._value("GetValue")

    async def put_value(self, value: object) -> None:
        """Write its contents."""
        await self._do("PutValue", value)


class Robot(_Described, _WithVariables, _Executing):
    """A robot arm. Much of this moves it."""

    owner = ObjectClass.ROBOT

    async def accelerate(self, axis: int, accel: float, decel: float) -> None:
        """Set internal acceleration and deceleration in per cent; axis -1 is the tool tip."""
        await self._do("Accelerate", axis, accel, decel)

    async def change(self, name: str) -> None:
        """Change tool or work, such as ``Tool1``."""
        await self._do("Change", name)

    async def chuck(self, option: str = "") -> None:
        """Close the hand."""
        await self._do("Chuck", option)

    async def drive(self, axis: int, distance: float, option: str = "") -> None:
        """Move one axis by a distance, degrees or mm."""
        await self._do("Drive", axis, distance, option)

    async def go_home(self) -> None:
        """Move to the home position."""
        await self._do("GoHome")

    async def halt(self, option: str = "") -> None:
        """Stop the motion and forget it."""
        await self._do("Halt", option)

    async def hold(self, option: str = "") -> None:
        """Stop the motion; `unhold` goes on."""
        await self._do("Hold", option)

    async def move(self, interpolation: int, pose: object, option: str = "") -> None:
        """Move to a pose such as ``@E J(0,0,90)``; interpolation 1 is PTP, 2 line, 3 arc, 4 free curve."""
        await self._do("Move", interpolation, pose, option)

    async def rotate(self, plane: object, angle: float, pivot: object, option: str = "") -> None:
        """Rotate around an axis by degrees."""
        await self._do("Rotate", plane, angle, pivot, option)

    async def speed(self, axis: int, speed: float) -> None:
        """Set the internal speed in per cent; axis -1 is the tool tip."""
        await self._do("Speed", axis, speed)

    async def unchuck(self, option: str = "") -> None:
        """Open the hand."""
        await self._do("Unchuck", option)

    async def unhold(self, option: str = "") -> None:
        """Go on with a motion that was held."""
        await self._do("Unhold", option)

    async def slv_change_mode(self, mode: int) -> None:
        """Enter a slave mode, or leave it with 0. The session leaves it by itself at the end of its block."""
        await self.execute("slvChangeMode", Variant(VT.I4, mode))

    async def slv_get_mode(self) -> int:
        """Return the slave mode."""
        return _result(await self._do("Execute", "slvGetMode", None), int, "a mode")

    async def slv_move(self, point: object) -> Value:
        """Send one set point; return where the robot is. A Variant chooses the type, a list becomes R8."""
        return await self._value("Execute", "slvMove", point)


class Task(_Described, _WithVariables, _Executing):
    """A program that runs or may run."""

    owner = ObjectClass.TASK

    async def start(self, mode: int, option: str = "") -> None:
        """Start it: 1 one cycle, 2 again and again, 3 one step."""
        await self._do("Start", mode, option)

    async def stop(self, mode: int, option: str = "") -> None:
        """Stop it: 0 as is usual, 1 at once, 2 after the step, 3 after the cycle, 4 and begin anew."""
        await self._do("Stop", mode, option)

    async def delete(self, option: str = "") -> None:
        """Delete it."""
        await self._do("Delete", option)

    async def get_file_name(self) -> str:
        """Return the name of its file."""
        return await self._text("GetFileName")


class Variable(_Described):
    """A variable."""

    owner = ObjectClass.VARIABLE

    async def get_value(self) -> Value:
        """Read it."""
        return await self._value("GetValue")

    async def put_value(self, value: object) -> None:
        """Write it; a Variant chooses the type, other values get one."""
        await self._do("PutValue", value)

    async def get_date_time(self) -> datetime:
        """Return when its value was taken, in the controller's time."""
        return await self._date("GetDateTime")

    async def get_microsecond(self) -> int:
        """Return the microseconds of that time."""
        return await self._number("GetMicrosecond")


class Command(_Described):
    """A stored command."""

    owner = ObjectClass.COMMAND

    async def execute(self, mode: int) -> Value:
        """Execute it; some servers answer with a value."""
        return await self._value("Execute", mode)

    async def cancel(self) -> None:
        """Give it up."""
        await self._do("Cancel")

    async def get_timeout(self) -> int:
        """Return its time-out in ms."""
        return await self._number("GetTimeout")

    async def put_timeout(self, value: int) -> None:
        """Set its time-out in ms."""
        await self._do("PutTimeout", value)

    async def get_state(self) -> int:
        """Return its state."""
        return await self._number("GetState")

    async def get_parameters(self) -> Value:
        """Return its parameters."""
        return await self._value("GetParameters")

    async def put_parameters(self, value: object) -> None:
        """Set its parameters."""
        await self._do("PutParameters", value)

    async def get_result(self) -> Value:
        """Return its result."""
        return await self._value("GetResult")


class Message(Remote):
    """A message from the controller."""

    owner = ObjectClass.MESSAGE

    async def reply(self, data: object) -> None:
        """Answer it."""
        await self._do("Reply", data)

    async def clear(self) -> None:
        """Clear it."""
        await self._do("Clear")

    async def get_date_time(self) -> datetime:
        """Return when it was made, in the controller's time."""
        return await self._date("GetDateTime")

    async def get_description(self) -> str:
        """Return what it says."""
        return await self._text("GetDescription")

    async def get_destination(self) -> str:
        """Return whom it is for."""
        return await self._text("GetDestination")

    async def get_number(self) -> int:
        """Return its number."""
        return await self._number("GetNumber")

    async def get_serial_number(self) -> int:
        """Return its serial number."""
        return await self._number("GetSerialNumber")

    async def get_source(self) -> str:
        """Return who sent it."""
        return await self._text("GetSource")

    async def get_value(self) -> Value:
        """Return what it carries."""
        return await self._value("GetValue")
