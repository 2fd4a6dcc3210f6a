"""A model of the controller's buffer: what it should have held whenever a set point came.

The model is a prediction, not an observation. It takes for granted

- that the controller takes one set point each period (8 ms) and begins with the first point, at once;
- that a set point reaches it when the capture sees the request that was answered, of an unanswered one the
  first. What the network takes on the way is left out; it is the same for all, or nearly;
- that a point which was refused is not put into the buffer;
- that its clock and that of the capture agree. They do not quite, so the buffer is set right by what is seen:
  it never holds more than its slots, S_BUF_FULL says that it is full, and where replies wait for room, a set
  point that finds it full is in when its reply comes.

Where in its period the controller is when a point comes is not known. A single tick without a point may be
that doubt alone and is counted apart, as one that may be; a point too many is predicted only where even a
controller that takes points as early as it can has no room for it. Slots by mode and the period are in
`bcapscope.protocol.slave_mode.modes`, with their sources.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, SlaveMode
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL, is_failure

DEFAULT_SLOTS = 3
"""Of a mode that is not known: what most modes of present controllers have."""

_NS_PER_MS = 1_000_000
_PERIOD = PERIOD_MS * _NS_PER_MS
_NEVER = 1 << 80
_MOVING = {1: True, 0: False, -1: None}


class PredictedUnderflow(NamedTuple):
    """A moment at which the model's buffer was empty when the controller wanted a set point.

    Attributes:
        time: when the point was wanted.
        last_frame: frame of the last set point before.
        late_frame: frame of the set point that came too late.
        missed_ticks: ticks of the controller that found nothing.
        late_ms: how long after `time` the point came.
        moving: whether the last two set points before differ; None where they could not be read.
    """

    time: int
    last_frame: int
    late_frame: int
    missed_ticks: int
    late_ms: float
    moving: bool | None


@dataclass(frozen=True, slots=True)
class BufferFacts:
    """The controller's buffer: what a model predicts and what the controller reported.

    Attributes:
        slots: set points that the buffer holds.
        period_ms: the model's period of the controller.
        overwrites: the newest point replaces the waiting one, so that running empty is no error.
        replies_pace: replies wait for room.
        assumptions: what the model takes for granted, a clause each.
        underflows: predicted, more than the unknown phase of the controller's clock can explain.
        underflows_in_motion: those of them in motion, where they matter.
        underflow_list: the first of them.
        possible_underflows: by one tick only: the phase decides.
        overflows: predicted: set points that came when the buffer was full, beyond the doubt of the phase.
        overflow_frames: the first of them, by frame of the request.
        overwritten: where `overwrites`, points replaced before they were taken; else 0.
        smallest_level: points in the buffer when the next one came, at worst; None for fewer than two.
        smallest_slack_ms: time that was left until the buffer would have been empty, at worst; negative
            where it was.
        smallest_slack_frame: frame of the set point that came then; None likewise.
        levels: how many set points found how many in the buffer.
        reported_underflows: frames of replies that said so (84201482).
        reported_overflows: frames of replies that said so (83201483).
        reported_full: frames of the first replies that said S_BUF_FULL.
    """

    slots: int
    period_ms: float
    overwrites: bool
    replies_pace: bool
    assumptions: tuple[str, ...]
    underflows: int
    underflows_in_motion: int
    underflow_list: tuple[PredictedUnderflow, ...]
    possible_underflows: int
    overflows: int
    overflow_frames: tuple[int, ...]
    overwritten: int
    smallest_level: int | None
    smallest_slack_ms: float | None
    smallest_slack_frame: int | None
    levels: Mapping[int, int]
    reported_underflows: tuple[int, ...]
    reported_overflows: tuple[int, ...]
    reported_full: tuple[int, ...]


def slack_ms(slots: int) -> float:
    """Return how long a full buffer lasts.

    A period a slot, two at the least, since a single slot is filled again while the point before is executed.
    """
    return float(max(slots, 2) * PERIOD_MS)


@dataclass(frozen=True, slots=True)
class BufferBehaviour:
    """How the buffer of a mode behaves, and what of it is only assumed."""

    slots: int
    overwrites: bool
    replies_pace: bool
    assumptions: tuple[str, ...]

    @classmethod
    def of_mode(cls, mode: SlaveMode | None, guessed: bool) -> BufferBehaviour:
        """Take the rules of a mode."""
        common = (
            f"the controller takes a set point each {PERIOD_MS} ms, the first one as it comes",
            "set points arrive when the capture sees them",
        )
        if mode is None:
            unknown = f"the mode is not known: {DEFAULT_SLOTS} slots, replies that do not wait"
            return cls(DEFAULT_SLOTS, False, False, (unknown, *common))
        doubt = ("the mode is read as on an RC8, since the generation is not known",) if guessed else ()
        return cls(mode.buffer_slots, mode.overwrites_waiting, mode.paces_client, (*doubt, *common))


class SetPointArrivals(NamedTuple):
    """Set points in the order in which they were sent, a row each.

    Attributes:
        times: when each came, nanoseconds since an origin.
        in_buffer_by: when each was in the buffer at the latest: when its reply came where replies wait for
            room.
        codes: HRESULT of each, 0 where it was not answered.
        frames: of the first request.
        reply_frames: 0 where there is none.
        moving: whether the one before was in motion, 1 or 0; -1 where that is not known.
    """

    times: NDArray[np.int64]
    in_buffer_by: NDArray[np.int64]
    codes: NDArray[np.int64]
    frames: NDArray[np.int64]
    reply_frames: NDArray[np.int64]
    moving: NDArray[np.int64]


class BufferModel:
    """Takes set points in order and predicts what the buffer held when each came."""

    def __init__(self, behaviour: BufferBehaviour, origin: int) -> None:
        """Take how the mode behaves, and the moment from which times are counted."""
        self._behaviour = behaviour
        self._origin = origin
        self._capacity_ns = behaviour.slots * _PERIOD
        # Points too many show only once they are more than the doubt of the phase, a point before and behind;
        # a point that replaces another is no matter of doubt.
        # Where replies wait for room, none is too many.
        self._most_excess_ns = (
            _PERIOD if behaviour.overwrites else _NEVER if behaviour.replies_pace else 2 * _PERIOD
        )
        self._excess_ns = 0  # what came beyond what the buffer holds, as time that it would last
        self._empty_at = 0  # when the controller will find nothing, as things stand
        self._last_frame = 0  # frame of the last set point of the rows before
        self._underflows: list[PredictedUnderflow] = []
        self._underflow_count = self._underflows_in_motion = self._possible_underflows = 0
        self._overflows: list[int] = []
        self._overflow_count = 0
        self._levels = [0] * (behaviour.slots + 1)
        self._smallest: tuple[int, int] | None = None
        self._underflow_frames: list[int] = []
        self._refused_frames: list[int] = []
        self._full_frames: list[int] = []

    def add(self, rows: SetPointArrivals) -> NDArray[np.int64]:
        """Take in set points, at least one.

        Returns:
            For each, nanoseconds from its coming until the buffer would have been empty, negative where it
            was; 0 for the very first.
        """
        if not self._last_frame:
            self._empty_at = int(rows.times[0])
        slacks = self._add_at_once(rows)
        if slacks is None:
            slacks = np.array(self._add_one_by_one(rows), np.int64)
        self._update_levels(slacks, rows.frames)
        return slacks

    def _add_at_once(self, rows: SetPointArrivals) -> NDArray[np.int64] | None:
        """Take in set points of which none is late, refused or too many; do nothing where one is.

        Each gives the buffer a period more, up to what it holds: a running minimum tells how long it lasts.
        """
        periods = np.arange(len(rows.times) + 1) * _PERIOD
        latest = rows.in_buffer_by + self._capacity_ns
        gained = np.minimum.accumulate(np.concatenate(((self._empty_at,), latest - periods[1:])))
        empty_at = gained + periods
        slacks = empty_at[:-1] - rows.times
        excess = self._excess_ns + int((gained[:-1] - gained[1:]).sum())
        if rows.codes.any() or (slacks < 0).any() or excess > self._most_excess_ns:
            return None
        self._empty_at = int(empty_at[-1])
        self._excess_ns = excess
        return slacks

    def _add_one_by_one(self, rows: SetPointArrivals) -> list[int]:
        slacks: list[int] = []
        keep, full = slacks.append, self._capacity_ns
        empty_at = self._empty_at
        codes, entered = rows.codes.tolist(), rows.in_buffer_by.tolist()
        for index, now in enumerate(rows.times.tolist()):
            slack = empty_at - now
            keep(slack)
            if slack < 0:
                empty_at = self._add_underflow(rows, index, empty_at)
            if codes[index]:
                empty_at = self._apply_result_code(rows, index, empty_at)
                continue
            empty_at += _PERIOD
            over = empty_at - entered[index] - full
            if over > 0:
                empty_at -= over
                self._excess_ns += over
                if self._excess_ns > self._most_excess_ns:
                    self._add_overflow(int(rows.frames[index]))
        self._empty_at = empty_at
        return slacks

    def _add_underflow(self, rows: SetPointArrivals, index: int, empty_at: int) -> int:
        """Note that nothing was there at `empty_at`; return when nothing would be there next."""
        late = int(rows.times[index]) - empty_at
        missing = (late - 1) // _PERIOD + 1
        self._excess_ns = 0
        if missing == 1:
            self._possible_underflows += 1
        else:
            moving = _MOVING[int(rows.moving[index])]
            self._underflow_count += 1
            self._underflows_in_motion += moving is not False
            if len(self._underflows) < MAX_LISTED:
                after = int(rows.frames[index - 1]) if index else self._last_frame
                before, late_ms = int(rows.frames[index]), late / _NS_PER_MS
                starved = PredictedUnderflow(self._origin + empty_at, after, before, missing, late_ms, moving)
                self._underflows.append(starved)
        return empty_at + missing * _PERIOD

    def _apply_result_code(self, rows: SetPointArrivals, index: int, empty_at: int) -> int:
        """Take what the controller says about its buffer; return when it will be empty."""
        code, reply = int(rows.codes[index]), int(rows.reply_frames[index])
        if code == S_BUF_FULL:
            _append_bounded(self._full_frames, reply)
            self._excess_ns = 0
            return int(rows.times[index]) + self._capacity_ns
        if code == E_SLAVE_OVERFLOW:
            _append_bounded(self._refused_frames, reply)
            self._excess_ns = 0
        elif code == E_SLAVE_UNDERFLOW:
            _append_bounded(self._underflow_frames, reply)
        return empty_at if is_failure(code) else empty_at + _PERIOD

    def _add_overflow(self, frame: int) -> None:
        self._excess_ns -= _PERIOD
        self._overflow_count += 1
        _append_bounded(self._overflows, frame)

    def _update_levels(self, slacks: NDArray[np.int64], frames: NDArray[np.int64]) -> None:
        """Keep the levels and the smallest slack, but for the first set point of all."""
        first = 0 if self._last_frame else 1
        found = slacks[first:]
        self._last_frame = int(frames[-1])
        if not len(found):
            return
        levels = np.clip((found + (_PERIOD - 1)) // _PERIOD, 0, self._behaviour.slots)
        for level, count in enumerate(np.bincount(levels, minlength=self._behaviour.slots + 1).tolist()):
            self._levels[level] += count
        least = int(found.argmin())
        if self._smallest is None or int(found[least]) < self._smallest[0]:
            self._smallest = int(found[least]), int(frames[first + least])

    def facts(self) -> BufferFacts:
        """Tell what was predicted and reported so far."""
        rules, smallest = self._behaviour, self._smallest
        levels = {level: count for level, count in enumerate(self._levels) if count}
        return BufferFacts(
            slots=rules.slots,
            period_ms=PERIOD_MS,
            overwrites=rules.overwrites,
            replies_pace=rules.replies_pace,
            assumptions=rules.assumptions,
            underflows=self._underflow_count,
            underflows_in_motion=self._underflows_in_motion,
            underflow_list=tuple(self._underflows),
            possible_underflows=self._possible_underflows,
            overflows=0 if rules.overwrites else self._overflow_count,
            overflow_frames=() if rules.overwrites else tuple(self._overflows),
            overwritten=self._overflow_count if rules.overwrites else 0,
            smallest_level=min(levels) if levels else None,
            smallest_slack_ms=smallest[0] / _NS_PER_MS if smallest else None,
            smallest_slack_frame=smallest[1] if smallest else None,
            levels=levels,
            reported_underflows=tuple(self._underflow_frames),
            reported_overflows=tuple(self._refused_frames),
            reported_full=tuple(self._full_frames),
        )


def _append_bounded(frames: list[int], frame: int) -> None:
    if len(frames) < MAX_LISTED:
        frames.append(frame)
