"""The proxy's guard refuses requests that are not allowed, but it never refuses a stop."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.protocol.codec.arguments import SMALLEST_ARGUMENT
from bcapscope.protocol.codec.frame import (
    EOT,
    HEADER_SIZE,
    LARGEST_FRAME,
    SMALLEST_FRAME,
    SOH,
    Frame,
    Framing,
    parse_datagram,
)
from bcapscope.protocol.codec.frame_content import has_zlib_header
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.guard import always_passes, passes_read_only
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS, commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS, function_name
from bcapscope.traffic.call_kind import CallKind, CallKinds
from bcapscope.traffic.filter.tokens import with_nearest

_FUNCTIONS = {function.name.casefold(): function.id for function in FUNCTIONS.values()}
_COMMANDS = {
    command.name.casefold(): command.name
    for function_id in sorted(COMMAND_FUNCTIONS)
    for command in commands_of(function_id)
}


class GuardTarget(NamedTuple):
    """Selects requests to block or allow, by function and by command in lower case. None means any."""

    function_id: int | None
    command: str | None

    def matches(self, kind: CallKind) -> bool:
        if self.function_id not in (None, kind.function_id):
            return False
        return self.command is None or (kind.command or "").casefold() == self.command

    def may_match(self, function_id: int, command: str | None) -> bool:
        """Return True if a controller could interpret a request as a call of this target. An unknown
        `command` is None. Like orin_bcap's C code, ignore text after a NUL, and blanks around the command.
        """
        if self.function_id not in (None, function_id):
            return False
        if self.command is None:
            return True
        if command is None:
            return function_id in COMMAND_FUNCTIONS
        return command.partition("\0")[0].strip().casefold() == self.command


def read_target(text: str) -> GuardTarget:
    """Parse a target: ``Robot_Move``, ``slvMove``, or ``Robot_Execute:AnyName`` for an unknown command."""
    name, colon, command = text.partition(":")
    function_id = _FUNCTIONS.get(name.casefold())
    if colon:
        if function_id not in COMMAND_FUNCTIONS:
            takers = ", ".join(FUNCTIONS[each].name for each in sorted(COMMAND_FUNCTIONS))
            raise InputError(Message("guard.no-commands", name=f"{name!r}", takers=takers))
        return GuardTarget(function_id, command.casefold())
    if function_id is not None:
        return GuardTarget(function_id, None)
    if name.casefold() in _COMMANDS:
        return GuardTarget(None, name.casefold())
    known = [*(function.name for function in FUNCTIONS.values()), *_COMMANDS.values()]
    unknown = with_nearest(Message("guard.unknown", name=f"{name!r}"), name, known)
    raise InputError(Message("guard.unknown-hint", reason=unknown, name=name))


class GuardResult(NamedTuple):
    """The bytes of the frames that pass, the refused frames, and the number of bytes that are not a frame."""

    passing: bytes
    refused: tuple[tuple[Frame, Message], ...]
    dropped: int


class RequestGuard:
    """Refuses requests. Requests that stop something or release a handle always pass. The guard drops bytes
    that are not a frame, because a controller could find an unchecked frame in these bytes.
    """

    def __init__(
        self, read_only: bool = False, block: Iterable[GuardTarget] = (), allow: Iterable[GuardTarget] = ()
    ) -> None:
        """Refuse the requests in `block`. With `read_only`, also refuse requests that are unknown, move the
        robot or change the robot's state. `allow` lists exceptions to `read_only`.
        """
        self.read_only = read_only
        self._block = tuple(block)
        self._allow = tuple(allow)
        self._templates = FrameTemplates()
        self._kinds = CallKinds()

    def filter_frames(self, data: bytes) -> GuardResult:
        passing, refused, dropped = [], [], 0
        for item in parse_datagram(data, self._templates):
            if not isinstance(item, Frame):
                dropped += len(item.raw)
            elif (why := self.refusal_reason(item)) is not None:
                refused.append((item, why))
            else:
                passing.append(item.raw)
        return GuardResult(b"".join(passing), tuple(refused), dropped)

    def refusal_reason(self, request: Frame) -> Message | None:
        """Return the reason why the guard refuses a request; None if the request passes.

        The guard refuses a damaged frame if it would refuse one of the frame's possible interpretations. To
        find the end of an argument, a controller may decode the argument's value, as orin_bcap's C, C#, Java
        and Python code does, or read the argument's length field, as the older C client does. Every
        controller reads the bytes of an argument's value as data, and never looks for a frame in them.
        """
        if _only_stops(request):
            return None
        kind, sound = self._kinds.kind_of(request), not request.problems and _reads_one_way(request)
        name = _request_name(kind)
        function_id, command = kind
        if sound and any(target.may_match(function_id, command) for target in self._block):
            return Message("guard.blocked", name=name)
        if self.read_only:
            damaged = Message("guard.read-only.damaged", name=name)
            return self._read_only_refusal(request, kind) if sound else damaged
        if sound or not self._may_be_blocked(request):
            return None
        return Message("guard.damaged", name=name)

    def _may_be_blocked(self, damaged: Frame) -> bool:
        if not _is_whole(damaged) or not _reads_one_way(damaged) or _hides_frame(damaged.raw):
            return True
        return any(target.may_match(damaged.code, None) for target in self._block)

    def _read_only_refusal(self, request: Frame, kind: CallKind) -> Message | None:
        values = request.variants
        if any(target.matches(kind) for target in self._allow) or passes_read_only(request.code, values):
            return None
        return Message("guard.read-only", name=_request_name(kind))


def _only_stops(request: Frame) -> bool:
    """Return whether a request only stops something or releases a handle, on every controller."""
    values = request.variants
    if not always_passes(request.code, values) or not _is_whole(request) or not _reads_one_way(request):
        return False
    if not request.problems:
        return True
    # Errors in the arguments do not matter if the function always stops or releases something.
    by_number = request.body is request.raw and always_passes(request.code, ())
    return by_number and not _hides_frame(request.raw)


def _is_whole(frame: Frame) -> bool:
    """Return whether every controller finds the end of the frame at the same byte."""
    raw = frame.raw
    return SMALLEST_FRAME <= len(raw) == frame.length and raw[-1] == EOT and frame.external_problem is None


def _reads_one_way(frame: Frame) -> bool:
    """Return whether all controllers read a frame in the same way: either as compressed, or as plain.

    The two bytes at offset 13 are the zlib header of a compressed frame, or the number of arguments of a
    plain frame. The bytes of a zlib header, read as a number, give at least 376. A frame that is too short
    for this number of arguments can only be a compressed frame.
    """
    raw = frame.raw
    if not has_zlib_header(raw):
        return True
    argc = int.from_bytes(raw[13:HEADER_SIZE], "little")
    is_packed = frame.framing is Framing.VERSION_1_ZLIB
    return is_packed and HEADER_SIZE + argc * SMALLEST_ARGUMENT > len(raw)


def _hides_frame(raw: bytes) -> bool:
    """Return whether a controller may find another frame, or the start of one, inside these bytes."""
    place = raw.find(SOH, 1)
    while place != -1:
        length = int.from_bytes(raw[place + 1 : place + 5], "little")
        stop = place + length
        if SMALLEST_FRAME <= length < LARGEST_FRAME and (stop > len(raw) or raw[stop - 1] == EOT):
            return True
        place = raw.find(SOH, place + 1)
    return False


def _request_name(kind: CallKind) -> str:
    name = function_name(kind.function_id)
    return name if kind.command is None else f"{name} {kind.command[:60]!r}"
