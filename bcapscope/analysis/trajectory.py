"""The way that set points describe, stay by stay, without what only the network added.

One step is one slvMove, however often it was sent; it has the time of the first request. Refused set points
are no part of the way, since the controller did not take them. Those whose reply was not seen are: nothing
says that it did not, and a hole would be a jump.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, TypeAlias

import numpy as np

from bcapscope.analysis.points import Points
from bcapscope.analysis.slave import SlaveWatcher
from bcapscope.analysis.stay import Format, Mode, Stay
from bcapscope.protocol.hresult import is_failure
from bcapscope.protocol.poses import Axis
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question

MOST_UNWANTED = 64 * 2048
"""Set points not asked for that are remembered until they are looked at: as many as can wait at a time."""


class LeftOut(StrEnum):
    """Why a set point is no step."""

    REFUSED = "refused by the controller"
    AFTER_END = "unanswered after slave mode had ended"
    UNREADABLE = "without a pose that fits the others"
    NOT_WANTED = "not asked for"


@dataclass(frozen=True, slots=True)
class Trajectory:
    """What is known of a way before its first step.

    Attributes:
        stay: number of the stay in slave mode, as `slave` counts them.
        conversation: whose set points they are.
        robot: handle of the robot; None where it could not be read.
        mode: as far as it was known then.
        send_format: accepted send format; None where none was seen.
        receive_format: likewise.
        axes: of each pose, at least one.
        start: nanoseconds since 1970, of the first request of the first step.
        has_stamps: the replies carry the controller's time.
        grid_ms: period that the set points should keep.
    """

    stay: int
    conversation: Conversation
    robot: int | None
    mode: Mode
    send_format: Format | None
    receive_format: Format | None
    axes: tuple[Axis, ...]
    start: int
    has_stamps: bool
    grid_ms: float


class Step(NamedTuple):
    """One set point.

    Attributes:
        call: its number.
        time: nanoseconds since 1970, of the first request.
        replied: likewise, of the accepted reply; None where there is none.
        retries: requests beyond the first.
        hresult: of the reply; None likewise.
        commanded: a number an axis.
        returned: a number an axis; () where none came back.
        stamp: the controller's time in milliseconds; None where there is none.
    """

    call: int
    time: int
    replied: int | None
    retries: int
    hresult: int | None
    commanded: tuple[float, ...]
    returned: tuple[float, ...]
    stamp: float | None


Piece: TypeAlias = "tuple[Trajectory, Sequence[Step]]"
"""Steps that follow each other on one way."""


class Trajectories:
    """Follows calls as a tracker gives them out and tells the steps; none is kept."""

    def __init__(
        self,
        wanted: Callable[[Exchange], bool] | None = None,
        whose: Callable[[Conversation], bool] | None = None,
    ) -> None:
        """Begin; all calls have to be taken whatever is wanted, since any may begin or end a stay.

        Args:
            wanted: chooses set points; the others are left out.
            whose: chooses clients; those of the others are not even counted.
        """
        self._wanted = wanted
        self._whose = whose
        self._watcher = SlaveWatcher(heed=self._heed)
        self._known: dict[int, Trajectory] = {}
        self._found: list[Piece] = []
        self._seen = self._told = 0
        self._left_out: Counter[LeftOut] = Counter()
        self._question: Question | None = None
        self._unwanted: dict[int, None] = {}  # calls that have not come back as points yet, in order

    def take(self, call: Exchange) -> Sequence[Piece]:
        """Take in a call that settled; return the steps that are ready."""
        question = call.question
        if question is self._question or _is_set_point(question):
            self._question = question
            self._count(call)
        self._forget(self._watcher.take(call))
        return self._take_found() if self._found else ()

    def finish(self) -> Sequence[Piece]:
        """Return the steps that were not told yet; the traffic has ended."""
        self._forget(self._watcher.finish())
        return self._take_found()

    @property
    def set_points(self) -> int:
        """How many calls of slvMove there were."""
        return self._seen

    @property
    def left_out(self) -> Mapping[LeftOut, int]:
        """How many set points were left out, and why; complete after `finish`."""
        counted = dict(self._left_out)
        after = self._seen - self._told - sum(counted.values())
        return {**counted, LeftOut.AFTER_END: after} if after else counted

    def _count(self, call: Exchange) -> None:
        if self._whose is not None and not self._whose(call.conversation):
            return
        self._seen += 1
        code = call.hresult
        if code and is_failure(code):
            self._left_out[LeftOut.REFUSED] += 1
        elif self._wanted is not None and not self._wanted(call):
            self._unwanted[call.call] = None
            if len(self._unwanted) > MOST_UNWANTED:
                del self._unwanted[next(iter(self._unwanted))]

    def _forget(self, stays: Sequence[Stay]) -> None:
        for stay in stays:
            self._known.pop(stay.number, None)

    def _take_found(self) -> Sequence[Piece]:
        found, self._found = self._found, []
        return found

    def _heed(self, points: Points) -> None:
        if self._whose is not None and not self._whose(points.conversation):
            return
        rows = [row for row in _taken(points) if self._is_wanted(points, row)]
        if not rows:
            return
        known = self._known.get(points.stay)
        if known is None:
            known = self._known[points.stay] = _begin(points, rows[0])
        self._told += len(rows)
        self._found.append((known, tuple(_steps(points, rows))))

    def _is_wanted(self, points: Points, row: int) -> bool:
        call = points.rows.calls[row]
        if call in self._unwanted:
            del self._unwanted[call]
            self._left_out[LeftOut.NOT_WANTED] += 1
            return False
        if not points.axes or not points.commanded.posed[row]:
            self._left_out[LeftOut.UNREADABLE] += 1
            return False
        return True


def _is_set_point(question: Question) -> bool:
    return question.command is not None and question.command.casefold() == "slvmove"


def _taken(points: Points) -> Iterator[int]:
    """Yield the rows that were not refused."""
    return (row for row, code in enumerate(points.rows.codes.tolist()) if not (code and is_failure(code)))


def _begin(points: Points, row: int) -> Trajectory:
    stamped = bool((~np.isnan(points.returned.stamps)).any())
    return Trajectory(
        stay=points.stay,
        conversation=points.conversation,
        robot=points.robot,
        mode=points.mode,
        send_format=points.send,
        receive_format=points.receive,
        axes=points.axes,
        start=points.rows.origin + int(points.rows.times[row]),
        has_stamps=stamped,
        grid_ms=points.grid_ms,
    )


def _steps(points: Points, rows: Sequence[int]) -> Iterator[Step]:
    unit = 1000 if points.microseconds else 1
    commanded, returned = points.commanded.poses.tolist(), points.returned.poses.tolist()
    stamps, posed = points.returned.stamps.tolist(), points.returned.posed.tolist()
    origin, calls, times = points.rows.origin, points.rows.calls, points.rows.times.tolist()
    answered, replies = points.rows.answered.tolist(), points.rows.replies.tolist()
    codes, retries = points.rows.codes.tolist(), points.rows.retries.tolist()
    for row in rows:
        stamp = stamps[row]
        yield Step(
            call=calls[row],
            time=origin + times[row],
            replied=origin + replies[row] if answered[row] else None,
            retries=retries[row],
            hresult=codes[row] if answered[row] else None,
            commanded=tuple(commanded[row]),
            returned=tuple(returned[row]) if posed[row] else (),
            stamp=None if math.isnan(stamp) else stamp / unit,
        )
