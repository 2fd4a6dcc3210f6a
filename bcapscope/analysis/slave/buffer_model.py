"""Model of the controller's buffer: how much it should have held when each set point arrived.

The model is a prediction, not an observation. It assumes:

- The controller takes one set point per period (8 ms) and begins with the first point at once.
- A set point reaches the controller when the capture sees the answered request; for an unanswered one, when
  it sees the first request. The network delay is ignored, because it is nearly the same for all set points.
- The controller does not put a refused point into the buffer.
- The clocks of the controller and of the capture agree. They drift slightly, so observations correct the
  model. The buffer never holds more than its slots, and S_BUF_FULL says that it is full. Where replies wait
  for room, a set point that finds the buffer full is in the buffer when its reply arrives.

The phase of the controller's period is unknown when a point arrives. A single tick without a point may be due
to that alone, so it counts separately, as a possible underflow. An overflow is predicted only if even a
controller that takes points as early as possible has no room. Slots per mode and the period are in
`bcapscope.protocol.slave_mode.modes`, with their sources.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Quantity
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, SlaveMode
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL, is_failure

DEFAULT_SLOTS = 3
"""Slots of an unknown mode: the number that most modes of present controllers have."""

_NS_PER_MS = 1_000_000
_PERIOD = PERIOD_MS * _NS_PER_MS
_NEVER = 1 << 80
_MOVING = {1: True, 0: False, -1: None}


class PredictedUnderflow(NamedTuple):
    """A moment at which the model's buffer was empty when the controller needed a set point.

    Attributes:
        time: Time when the controller needed the point, ns since 1970.
        late_frame: Frame of the set point that arrived too late.
        late_ms: Delay of the set point after `time`, ms.
        moving: True if the last two set points before differ; None if they are unreadable.
    """

    time: int
    last_frame: int
    late_frame: int
    missed_ticks: int
    late_ms: float
    moving: bool | None


@dataclass(frozen=True, slots=True)
class BufferFacts:
    """The controller's buffer: predictions of the model, and reports of the controller.

    Attributes:
        slots: Number of set points that the buffer holds.
        overwrites: The newest point replaces the waiting one, so an empty buffer is no error.
        replies_pace: Replies wait for room in the buffer.
        underflows: Number of predicted underflows that the unknown phase of the controller cannot explain.
        underflows_in_motion: Those of them during motion, where they matter.
        underflow_list: The first of them.
        possible_underflows: Number of underflows by one tick, which the unknown phase may explain.
        overflows: Number of predicted overflows: set points that found the buffer full, whatever the phase.
        overflow_frames: Request frames of the first of them.
        overwritten: Number of points replaced before the controller took them; 0 unless `overwrites`.
        smallest_level: Lowest level when a point arrived; None for fewer than two set points.
        smallest_slack_ms: Shortest time left until the buffer would have been empty; negative if it was
            empty.
        smallest_slack_frame: Frame of the set point that arrived then; None for fewer than two set points.
        reported_underflows: Frames of replies that reported an underflow (84201482).
        reported_overflows: Frames of replies that reported an overflow (83201483).
        reported_full: Frames of the first replies with S_BUF_FULL.
    """

    slots: int
    period_ms: float
    overwrites: bool
    replies_pace: bool
    assumptions: tuple[Message, ...]
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
    """Return how long a full buffer lasts, in ms.

    It lasts one period per slot, and at least two: a single slot is refilled while the controller executes
    the previous point.
    """
    return float(max(slots, 2) * PERIOD_MS)


@dataclass(frozen=True, slots=True)
class BufferBehaviour:
    """Behaviour of a mode's buffer, and which parts of it are assumed."""

    slots: int
    overwrites: bool
    replies_pace: bool
    assumptions: tuple[Message, ...]

    @classmethod
    def of_mode(cls, mode: SlaveMode | None, guessed: bool) -> BufferBehaviour:
        common = (
            Message("buffer.assumes.period", period=Quantity(PERIOD_MS, "ms")),
            Message("buffer.assumes.arrival"),
        )
        if mode is None:
            unknown = Message("buffer.assumes.unknown-mode", slots=Count(DEFAULT_SLOTS, "slot"))
            return cls(DEFAULT_SLOTS, False, False, (unknown, *common))
        doubt = (Message("buffer.assumes.generation"),) if guessed else ()
        return cls(mode.buffer_slots, mode.overwrites_waiting, mode.paces_client, (*doubt, *common))


class SetPointArrivals(NamedTuple):
    """Set points in the order in which they were sent, one row each.

    Attributes:
        times: Arrival time, ns since an origin.
        in_buffer_by: Latest time at which the point was in the buffer: that of its reply where replies wait
            for room.
        codes: HRESULT; 0 without a reply.
        frames: Frame of the first request.
        reply_frames: Frame of the reply; 0 without one.
        moving: 1 if the previous set point was in motion, 0 if not, -1 if unknown.
    """

    times: NDArray[np.int64]
    in_buffer_by: NDArray[np.int64]
    codes: NDArray[np.int64]
    frames: NDArray[np.int64]
    reply_frames: NDArray[np.int64]
    moving: NDArray[np.int64]


class BufferModel:
    """Predicts how much the buffer held when each set point arrived; set points must be added in order."""

    def __init__(self, behaviour: BufferBehaviour, origin: int) -> None:
        """Create a model; times count from `origin` in ns."""
        self._behaviour = behaviour
        self._origin = origin
        self._capacity_ns = behaviour.slots * _PERIOD
        # An overflow is certain only beyond the doubt about the phase, which is one point on either side. For
        # a point that replaces another there is no such doubt. Where replies wait for room, no point is too
        # many.
        self._most_excess_ns = (
            _PERIOD if behaviour.overwrites else _NEVER if behaviour.replies_pace else 2 * _PERIOD
        )
        self._excess_ns = 0  # what arrived beyond the capacity, as the time that it would last
        self._empty_at = 0  # when the controller will find the buffer empty, as far as known now
        self._last_frame = 0  # frame of the last set point of the previous rows
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
        """Add one or more set points.

        Returns:
            Time in ns from the arrival of each until the buffer would have been empty; negative if it was
                empty. 0 for the very first.
        """
        if not self._last_frame:
            self._empty_at = int(rows.times[0])
        slacks = self._add_at_once(rows)
        if slacks is None:
            slacks = np.array(self._add_one_by_one(rows), np.int64)
        self._update_levels(slacks, rows.frames)
        return slacks

    def _add_at_once(self, rows: SetPointArrivals) -> NDArray[np.int64] | None:
        """Add set points in one step; change nothing and return None if any is late, refused or too many.

        Each point extends the buffer by one period, up to the capacity. A running minimum gives the time that
        it lasts.
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
        """Record that the buffer was empty at `empty_at`; return when it is empty next."""
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
        """Apply what a reply says about the buffer; return when the buffer will be empty."""
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
        """Update the levels and the smallest slack; the very first set point does not count."""
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
