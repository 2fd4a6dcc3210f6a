"""The guard: requests that it does not let through, and those that nobody holds up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

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
from bcapscope.protocol.codec.frame_content import has_compressed_header, has_zlib_header
from bcapscope.protocol.guard import always_passes, passes_read_only
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS, function_name
from bcapscope.traffic.call_kind import COMMAND_FUNCTIONS, CallKind, call_kind_of
from bcapscope.traffic.filter.tokens import nearest

_FUNCTIONS = {function.name.casefold(): function.id for function in FUNCTIONS.values()}
_COMMANDS = {
    command.name.casefold(): command.name
    for function_id in sorted(COMMAND_FUNCTIONS)
    for command in commands_of(function_id)
}


class GuardTarget(NamedTuple):
    """A function, a command, or a command of one function.

    Attributes:
        function_id: None for any function.
        command: in lower case; None for any.
    """

    function_id: int | None
    command: str | None

    def matches(self, question: CallKind) -> bool:
        """Tell whether a request is meant."""
        if self.function_id not in (None, question.function_id):
            return False
        return self.command is None or (question.command or "").casefold() == self.command

    def may_match(self, function_id: int, command: str | None) -> bool:
        """Tell whether a controller may take a request for what is meant.

        Args:
            function_id: of the request.
            command: of the request; None where there is none that can be read for certain. What stands behind
                a NUL or blanks around it counts for nothing, as in orin_bcap's C.
        """
        if self.function_id not in (None, function_id):
            return False
        if self.command is None:
            return True
        if command is None:
            return function_id in COMMAND_FUNCTIONS
        return command.partition("\0")[0].strip().casefold() == self.command


def read_target(text: str) -> GuardTarget:
    """Read ``Robot_Move``, ``slvMove``, or ``Robot_Execute:AnyName`` for a command that is not known.

    Raises:
        ValueError: there is no such function or command.
    """
    name, colon, command = text.partition(":")
    function_id = _FUNCTIONS.get(name.casefold())
    if colon:
        if function_id not in COMMAND_FUNCTIONS:
            takers = ", ".join(FUNCTIONS[each].name for each in sorted(COMMAND_FUNCTIONS))
            raise ValueError(f"{name!r} takes no commands; these do: {takers}")
        return GuardTarget(function_id, command.casefold())
    if function_id is not None:
        return GuardTarget(function_id, None)
    if name.casefold() in _COMMANDS:
        return GuardTarget(None, name.casefold())
    hint = nearest(name, [*(function.name for function in FUNCTIONS.values()), *_COMMANDS.values()])
    raise ValueError(
        f"there is no function or command {name!r}{hint}; a command that is not in the catalogue is written "
        f"with its function, Robot_Execute:{name}"
    )


class GuardResult(NamedTuple):
    """What a guard has made of a message.

    Attributes:
        passing: the bytes that may go on: whole frames.
        refused: the other frames, and why.
        dropped: bytes that are no frame.
    """

    passing: bytes
    refused: tuple[tuple[Frame, str], ...]
    dropped: int


class RequestGuard:
    """Refuses requests. Requests that stop something or release a handle always pass.

    Only whole frames pass. A controller therefore finds no frame that the guard has not judged, wherever it
    resumes after bytes that it rejects.
    """

    def __init__(
        self, read_only: bool = False, block: Iterable[GuardTarget] = (), allow: Iterable[GuardTarget] = ()
    ) -> None:
        """Set it up.

        Args:
            read_only: refuse what moves the robot or changes its state, and what is not known.
            block: refuse these.
            allow: let these through though `read_only` would not; `block` comes first.
        """
        self.read_only = read_only
        self._block = tuple(block)
        self._allow = tuple(allow)

    def filter_frames(self, data: bytes) -> GuardResult:
        """Look at all that is in a datagram, or in a piece of a stream that was cut into frames."""
        passing, refused, dropped = [], [], 0
        for item in parse_datagram(data):
            if not isinstance(item, Frame):
                dropped += len(item.raw)
            elif why := self.refusal_reason(item):
                refused.append((item, why))
            else:
                passing.append(item.raw)
        return GuardResult(b"".join(passing), tuple(refused), dropped)

    def refusal_reason(self, request: Frame) -> str:
        """Return why a request is refused; "" if it is not.

        Controllers read a damaged frame in different ways: by the values of its arguments, as orin_bcap's C,
        C#, Java and Python do, or by their lengths, as the older C client does. The guard refuses it if one
        of these readings might be refused. A frame inside the value of an argument is data: all skip it.
        """
        if _only_stops(request):
            return ""
        question, sound = call_kind_of(request), not request.problems and _reads_one_way(request)
        name = _request_name(question)
        function_id, command = question
        if sound and any(target.may_match(function_id, command) for target in self._block):
            return f"{name} is blocked"
        if self.read_only:
            return self._read_only_refusal(request, question) if sound else f"read-only: a damaged {name}"
        if sound or not self._may_be_blocked(request):
            return ""
        return f"a damaged {name}, which may be read as what is blocked"

    def _may_be_blocked(self, damaged: Frame) -> bool:
        if not _is_whole(damaged) or not _reads_one_way(damaged) or _hides_frame(damaged.raw):
            return True
        return any(target.may_match(damaged.code, None) for target in self._block)

    def _read_only_refusal(self, request: Frame, question: CallKind) -> str:
        values = request.variants
        if any(target.matches(question) for target in self._allow) or passes_read_only(request.code, values):
            return ""
        return f"read-only: {_request_name(question)}"


def _only_stops(request: Frame) -> bool:
    """Return whether a request, however it is read, stops something or releases a handle, and no more."""
    values = request.variants
    if not always_passes(request.code, values) or not _is_whole(request) or not _reads_one_way(request):
        return False
    if not request.problems:
        return True
    # Its number alone decides what it does, so a client may err in the arguments.
    by_number = request.body is request.raw and always_passes(request.code, ())
    return by_number and not _hides_frame(request.raw)


def _is_whole(frame: Frame) -> bool:
    """Tell whether all find its end in the same place."""
    raw = frame.raw
    return SMALLEST_FRAME <= len(raw) == frame.length and raw[-1] == EOT and frame.external_problem is None


def _reads_one_way(frame: Frame) -> bool:
    """Return whether a frame cannot be both compressed and plain.

    A frame that looks compressed must be so in every respect. As a plain one it would have 376 arguments or
    more, for which it must have no room.
    """
    raw = frame.raw
    if not has_zlib_header(raw):
        return True
    argc = int.from_bytes(raw[13:HEADER_SIZE], "little")
    is_packed = has_compressed_header(raw) and frame.framing is Framing.VERSION_1_ZLIB
    return is_packed and HEADER_SIZE + argc * SMALLEST_ARGUMENT > len(raw)


def _hides_frame(raw: bytes) -> bool:
    """Tell whether another frame may be found in these bytes, or begin in them and go on beyond."""
    place = raw.find(SOH, 1)
    while place > 0:
        length = int.from_bytes(raw[place + 1 : place + 5], "little")
        stop = place + length
        if SMALLEST_FRAME <= length < LARGEST_FRAME and (stop > len(raw) or raw[stop - 1] == EOT):
            return True
        place = raw.find(SOH, place + 1)
    return False


def _request_name(question: CallKind) -> str:
    name = function_name(question.function_id)
    return name if question.command is None else f"{name} {question.command[:60]!r}"
