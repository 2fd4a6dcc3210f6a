"""The client's side of a script, played to a controller, with the handles that this one gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from bcapscope.client.reach import Reach
from bcapscope.errors import BcapError, ControllerError
from bcapscope.player.channel import Channel
from bcapscope.player.checks_motion import NEAR
from bcapscope.player.station import Station, distance
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass, ResultKind
from bcapscope.protocol.hresult import is_failure, is_success
from bcapscope.protocol.poses import numbers
from bcapscope.protocol.requester import Answered, Settled, TimedOut
from bcapscope.protocol.slavemode import mode_pose_type
from bcapscope.protocol.variant import VT, Variant
from bcapscope.replay.script import Line, Script
from bcapscope.replay.setpoints import command_of, mode_entered

WHOLE, PART = 1e-3, 1e-4
"""Numbers that differ by less, absolutely or relatively, are the same: mm, degrees and seconds that a robot
comes back with are never equal to the last bit."""


class FarAwayError(BcapError):
    """The robot is not where the recording needs it, as far as is known."""


class Played(NamedTuple):
    """A call that was made again.

    Attributes:
        line: as it was recorded.
        arguments: as they were sent.
        settled: how it ended.
        late: ns that it was asked later than in the recording, since what came before took longer.
        differs: ended with another result code, or without a reply, or with one where there had been none.
        moved: ended with the same result code and other values, as a robot is never twice in the same place.
    """

    line: Line
    arguments: tuple[Variant, ...]
    settled: Settled
    late: int
    differs: bool
    moved: bool

    @property
    def failed(self) -> bool:
        """Whether it succeeded when it was recorded, and now did not."""
        then = self.line.hresult is not None and is_success(self.line.hresult)
        return then and not isinstance(self.settled, Answered)

    @property
    def unanswered(self) -> bool:
        """Whether it was answered when it was recorded, and now was not."""
        return self.line.hresult is not None and isinstance(self.settled, TimedOut)


class Performance:
    """Plays a script.

    What the recording uses and does not open, as its beginning was missed, is opened as `Reach` does; what it
    leaves open is for the session to let go of.
    """

    def __init__(
        self,
        script: Script,
        reach: Reach,
        channel: Channel,
        longest_pause: int,
        anywhere: bool = False,
    ) -> None:
        """Prepare.

        Args:
            script: to play.
            reach: of a session in which nothing is open yet.
            channel: whose clock and patience are used.
            longest_pause: longer ones between two calls are cut to that many ns.
            anywhere: enter slave mode wherever the robot stands.
        """
        self._script = script
        self._reach = reach
        self._channel = channel
        self._longest_pause = longest_pause
        self._anywhere = anywhere
        self._handles: dict[tuple[ObjectClass, int], int] = {}

    async def play(self, told: Callable[[Played], bool]) -> None:
        """Play it to its end.

        Args:
            told: is given every call that was made; the end comes early when it returns False.

        Raises:
            ValueError: an object is needed that nobody told the name of.
            FarAwayError: slave mode would begin far from where the robot stands; it is not entered.
            BcapError: what was missing could not be opened, or a call cannot be sent.
            OSError: the link is gone.
        """
        channel = self._channel
        start = channel.now()
        for place, (line, at) in enumerate(zip(self._script.lines, self._times(), strict=True)):
            arguments = await self._arguments(line)
            if arguments is None:
                continue
            if not self._anywhere:
                await self._check_start(place)
            channel.wait(start + at)
            late = channel.now() - start - at
            settled = await self._exchange(line, arguments)
            self._learn(line, settled)
            if not told(
                Played(line, arguments, settled, late, _differs(line, settled), _moved(line, settled))
            ):
                return

    def _times(self) -> Iterator[int]:
        """Yield when to ask each call, ns after the beginning."""
        at = last = 0
        for line in self._script.lines:
            at += min(line.at - last, self._longest_pause)
            last = line.at
            yield at

    async def _arguments(self, line: Line) -> tuple[Variant, ...] | None:
        """Put the handle of here and now in the place of the recorded one; None to let go of what is not."""
        function = FUNCTIONS.get(line.question.function_id)
        old = _first_number(line.arguments)
        if function is None or not function.takes_handle or old is None:
            return line.arguments
        owner = function.owner
        new = self._handles.get((owner, old))
        if new is None and line.hresult is not None and is_failure(line.hresult):
            return line.arguments  # perhaps refused for its handle, which nobody was ever given
        if new is None and function.releases is not None:
            return None
        if new is None:
            new = self._handles[owner, old] = await self._reach.handle(owner)
        return (Variant(VT.I4, new), *line.arguments[1:])

    async def _check_start(self, place: int) -> None:
        """Before slave mode is entered, look whether the robot stands where its first set point is."""
        mode = mode_entered(self._script.lines[place])
        kind = None if mode is None else mode_pose_type(mode)
        if kind is None:
            return
        moves = (line for line in self._script.lines[place + 1 :] if command_of(line) == "slvmove")
        first = next(moves, None)
        goal = None if first is None or len(first.arguments) < 3 else numbers(first.arguments[2])
        if first is None or goal is None:
            return
        try:
            here = await Station(self._reach, self._pause).pose(kind)
        except ControllerError as error:
            raise FarAwayError(
                f"slave mode was not entered, as nobody knows where the robot is: {error}"
            ) from None
        far = distance(kind, here, goal)
        if far > NEAR:
            raise FarAwayError(
                f"call {first.call}, the first set point, is {far:.3g} (degrees or mm) from where the robot "
                "stands: slave mode was not entered; bring the robot there first"
            )

    def _pause(self, length: int) -> None:
        self._channel.wait(self._channel.now() + length)

    async def _exchange(self, line: Line, arguments: tuple[Variant, ...]) -> Settled:
        function = FUNCTIONS.get(line.question.function_id)
        if function is None:
            return await self._reach.session.exchange(line.question.function_id, arguments)
        return await self._reach.exchange(function, arguments)

    def _learn(self, line: Line, settled: Settled) -> None:
        """Note which handle of here and now stands for the recorded one."""
        function = FUNCTIONS.get(line.question.function_id)
        if function is None or function.creates is None or not isinstance(settled, Answered):
            return
        then = _first_number(line.values)
        now = _first_number([argument.variant for argument in settled.reply.arguments])
        if then is not None and now is not None:
            self._handles[function.creates, then] = now


def _first_number(values: Sequence[Variant]) -> int | None:
    value = values[0].value if values else None
    return value if isinstance(value, int) else None


def _differs(line: Line, settled: Settled) -> bool:
    return line.hresult != (None if isinstance(settled, TimedOut) else settled.reply.code)


def _moved(line: Line, settled: Settled) -> bool:
    if isinstance(settled, TimedOut) or settled.reply.code != line.hresult:
        return False
    function = FUNCTIONS.get(line.question.function_id)
    if function is not None and function.result is ResultKind.HANDLE:
        return False
    return not _alike(line.values, tuple(argument.variant for argument in settled.reply.arguments))


def _alike(one: object, other: object) -> bool:
    """Compare values; a `Variant` is compared as the tuple that it is."""
    if isinstance(one, float) and isinstance(other, float):
        same = math.isclose(one, other, rel_tol=PART, abs_tol=WHOLE)
        return same or (math.isnan(one) and math.isnan(other))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_alike, one, other))
    return one == other
