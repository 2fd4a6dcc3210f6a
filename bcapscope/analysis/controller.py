"""What is learnt about a controller, whichever of its clients it is learnt from."""

from __future__ import annotations

from collections import deque

from bcapscope.analysis.course import Course, Key, Position, Setting, parameter_of
from bcapscope.analysis.generation import NO_CLUE, Clue
from bcapscope.analysis.stay import Call, Format
from bcapscope.protocol.poses import numbers
from bcapscope.protocol.slaveformat import format_parameter
from bcapscope.protocol.slavemode import PoseType, mode_value
from bcapscope.traffic.exchange import Exchange

MOST_CALLS = 1024
"""Calls that are no set points, remembered for each controller."""

MOST_BYTES = 1 << 20
"""Bytes of their frames."""

MOST_WAITING = 16
"""Stays without set points, of each controller."""

_POSITIONS = {"curjnt": PoseType.J, "curpos": PoseType.P, "curtrn": PoseType.T}


class Controller:
    """One controller.

    Attributes:
        clue: to its generation.
        calls: the latest that are no set points, in the order in which they settled.
        waiting: stays that have begun and have no set points yet.
        tried: slvChangeMode that was not answered, as far as was seen.
        mode_told: what slvGetMode said while no stay was known, and that it did.
    """

    def __init__(self) -> None:
        self.clue: Clue = NO_CLUE
        self.calls: deque[Exchange] = deque()
        self._weight = 0
        self.waiting: dict[Key, Course] = {}
        self.tried: Exchange | None = None
        self.mode_told: tuple[int | None, str] = (None, "")
        self._send: Format | None = None
        self._receive: Format | None = None
        self._position: Position | None = None

    def setting(self, mode: tuple[int | None, str]) -> Setting:
        """Return what is known now, for a stay in this mode."""
        value, known_by = mode
        return Setting(value, known_by, self.clue, self._send, self._receive, self._position)

    def remember(self, call: Exchange) -> None:
        """Keep a call that is no set point; the oldest are forgotten where there are too many."""
        self.calls.append(call)
        self._weight += call.weight
        while self.calls and (len(self.calls) > MOST_CALLS or self._weight > MOST_BYTES):
            self._weight -= self.calls.popleft().weight

    def between(self, begin: int, end: int) -> list[Exchange]:
        """Return the calls that were asked at that time or answered in it, in order of time."""
        found = [call for call in self.calls if call.request.time <= end and call.activity >= begin]
        return sorted(found, key=lambda call: call.request.time)

    def wait(self, key: Key, course: Course) -> Course | None:
        """Keep a stay until its first set point; return one that there is no more room for."""
        dropped = self.waiting.pop(next(iter(self.waiting))) if len(self.waiting) >= MOST_WAITING else None
        self.waiting[key] = course
        return dropped

    def adopt(self, key: Key) -> Course | None:
        """Return the stay that a set point belongs to: that which its client began, or another did."""
        if not self.waiting:
            return None
        course = self.waiting.pop(key, None) or self.waiting.pop(next(iter(self.waiting)))
        course.key = key
        return course

    def take_tried(self) -> Call | None:
        """Return the slvChangeMode without reply that must have been taken; only once."""
        tried, self.tried = self.tried, None
        if tried is None:
            return None
        self.mode_told = mode_asked(tried), "slvChangeMode"
        return fact_of(tried)

    def note_format(self, call: Exchange, command: str) -> None:
        """Note a format that was accepted."""
        parameter = parameter_of(call.request.item)
        found = None if parameter is None else format_parameter(parameter)
        if found is None:
            return
        format_ = Format(found.value, found.microseconds, call.request.number)
        if command == "slvsendformat":
            self._send = format_
        else:
            self._receive = format_

    def note_position(self, call: Exchange, command: str) -> None:
        """Note where the robot stands, if that is what was asked."""
        pose_type, reply = _POSITIONS.get(command), call.reply
        if pose_type is None or reply is None or not reply.item.arguments:
            return
        values = numbers(reply.item.arguments[0].variant)
        if values:
            frames = call.request.number, reply.number
            self._position = Position(pose_type, values, f"{call.question.command} before", frames)


def mode_asked(call: Exchange) -> int | None:
    """Return the mode that slvChangeMode asks for; None for other calls and where it cannot be read."""
    command = call.question.command
    if command is None or command.casefold() != "slvchangemode":
        return None
    parameter = parameter_of(call.request.item)
    return None if parameter is None else mode_value(parameter)


def fact_of(call: Exchange) -> Call:
    """Sum up a call."""
    reply = call.reply
    return Call(
        call=call.call,
        client=call.conversation.client,
        function_id=call.question.function_id,
        command=call.question.command,
        request=call.request.number,
        time=call.request.time,
        reply=None if reply is None else reply.number,
        replied=None if reply is None else reply.time,
        hresult=call.hresult,
    )
