"""The guard: requests that it does not let through, and those that nobody holds up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.protocol.arguments import SMALLEST_ARGUMENT
from bcapscope.protocol.commands import commands
from bcapscope.protocol.content import begins_zlib
from bcapscope.protocol.frame import (
    EOT,
    HEADER_SIZE,
    LARGEST_FRAME,
    SMALLEST_FRAME,
    SOH,
    Frame,
    Framing,
    parse_datagram,
)
from bcapscope.protocol.functions import FUNCTIONS, function_name
from bcapscope.protocol.guard import always_passes, passes_read_only
from bcapscope.traffic.filter_tokens import nearest
from bcapscope.traffic.question import COMMAND_FUNCTIONS, Question, question_of

_FUNCTIONS = {function.name.casefold(): function.id for function in FUNCTIONS.values()}
_COMMANDS = {
    command.name.casefold(): command.name
    for function_id in sorted(COMMAND_FUNCTIONS)
    for command in commands(function_id)
}


class Target(NamedTuple):
    """A function, a command, or a command of one function.

    Attributes:
        function_id: None for any function.
        command: in lower case; None for any.
    """

    function_id: int | None
    command: str | None

    def means(self, question: Question) -> bool:
        """Tell whether a request is meant."""
        if self.function_id not in (None, question.function_id):
            return False
        return self.command is None or (question.command or "").casefold() == self.command

    def may_mean(self, function_id: int, command: str | None) -> bool:
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


def read_target(text: str) -> Target:
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
        return Target(function_id, command.casefold())
    if function_id is not None:
        return Target(function_id, None)
    if name.casefold() in _COMMANDS:
        return Target(None, name.casefold())
    hint = nearest(name, [*(function.name for function in FUNCTIONS.values()), *_COMMANDS.values()])
    raise ValueError(
        f"there is no function or command {name!r}{hint}; a command that is not in the catalogue is written "
        f"with its function, Robot_Execute:{name}"
    )


class Sifted(NamedTuple):
    """What a guard has made of a message.

    Attributes:
        passing: the bytes that may go on: whole frames.
        refused: the other frames, and why.
        dropped: bytes that are no frame.
    """

    passing: bytes
    refused: tuple[tuple[Frame, str], ...]
    dropped: int


class Guard:
    """Refuses requests. Whatever stops the robot or lets go of something passes in any case.

    What passes are whole frames and nothing else, so that a controller cannot find other frames in it than
    were looked at, wherever it begins to look again after bytes that it does not like.
    """

    def __init__(
        self, read_only: bool = False, block: Iterable[Target] = (), allow: Iterable[Target] = ()
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

    def sift(self, data: bytes) -> Sifted:
        """Look at all that is in a datagram, or in a piece of a stream that was cut into frames."""
        passing, refused, dropped = [], [], 0
        for item in parse_datagram(data):
            if not isinstance(item, Frame):
                dropped += len(item.raw)
            elif why := self.refuses(item):
                refused.append((item, why))
            else:
                passing.append(item.raw)
        return Sifted(b"".join(passing), tuple(refused), dropped)

    def refuses(self, request: Frame) -> str:
        """Tell why a request is refused; "" if it is not.

        A damaged frame may be read in more ways than one: by the values of its arguments, as orin_bcap's C,
        C#, Java and Python do, or by their lengths, as the older C client does. It is refused if one of them
        might be refused.
        """
        if _only_stops(request):
            return ""
        question, sound = question_of(request), not request.problems and _reads_one_way(request)
        name = _name(question)
        function_id, command = question
        if sound and any(target.may_mean(function_id, command) for target in self._block):
            return f"{name} is blocked"
        if self.read_only:
            return self._not_reading(request, question) if sound else f"read-only: a damaged {name}"
        if sound or (
            _is_whole(request)
            and not _hides_frame(request.raw)
            and not any(target.may_mean(function_id, None) for target in self._block)
        ):
            return ""
        return f"a damaged {name}, which may be read as what is blocked"

    def _not_reading(self, request: Frame, question: Question) -> str:
        values = request.variants
        if any(target.means(question) for target in self._allow) or passes_read_only(request.code, values):
            return ""
        return f"read-only: {_name(question)}"


def _only_stops(request: Frame) -> bool:
    """Tell whether a request, however it is read, stops the robot or lets go of something, and no more."""
    values = request.variants
    if not always_passes(request.code, values) or not _is_whole(request) or not _reads_one_way(request):
        return False
    if not request.problems:
        return True
    # Its number alone tells what it does: a client that errs in the arguments is let go, too.
    by_number = request.body is request.raw and always_passes(request.code, ())
    return by_number and not _hides_frame(request.raw)


def _is_whole(frame: Frame) -> bool:
    """Tell whether all find its end in the same place."""
    raw = frame.raw
    return SMALLEST_FRAME <= len(raw) == frame.length and raw[-1] == EOT and frame.note is None


def _reads_one_way(frame: Frame) -> bool:
    """Tell whether a frame that looks compressed cannot be taken for a plain one.

    A plain one would have 376 arguments or more, for which there is no room in it.
    """
    raw = frame.raw
    if not begins_zlib(raw):
        return True
    argc = int.from_bytes(raw[13:HEADER_SIZE], "little")
    return frame.framing is Framing.VERSION_1_ZLIB and HEADER_SIZE + argc * SMALLEST_ARGUMENT > len(raw)


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


def _name(question: Question) -> str:
    name = function_name(question.function_id)
    return name if question.command is None else f"{name} {question.command[:60]!r}"
