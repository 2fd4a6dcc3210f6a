"""Model of the controller's buffer: how many set points the buffer held at the arrival of each set point.

The model is a prediction, not an observation. It assumes:

- The controller takes the first set point from the buffer as soon as this set point arrives, and then takes
  one set point per period (8 ms).
- A set point reaches the controller at the time when the answered attempt was captured. If no attempt was
  answered, the set point reaches the controller when its first attempt was captured. The network delay is
  ignored, because it is nearly the same for all set points.
- The controller does not put a refused set point into the buffer.
- The clocks of the controller and of the capture agree. In reality the clocks drift slightly, so the model
  uses the result codes of captured replies as corrections. S_BUF_FULL means that the buffer is full. In modes
  in which the controller sets the pace, a set point is in the buffer before its reply arrives.

A capture does not show at which moment of a period the controller takes set points. The model assumes that
the controller takes each set point at the earliest possible moment. The real controller may take the set
points up to one period later. Therefore a set point that misses the model's deadline by at most one period
counts as a possible underflow. A later set point counts as a predicted underflow. The model predicts an
overflow only if the buffer would be full for every possible moment at which the controller takes set points.

The module `bcapscope.protocol.slave_mode.modes` names the sources.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Quantity
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, SlaveMode
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL, is_failure

DEFAULT_SLOTS = 3
"""Number of buffer slots if the mode is unknown. Most modes of current controllers have three slots."""

_NS_PER_MS = 1_000_000
_PERIOD = PERIOD_MS * _NS_PER_MS
_NEVER = 1 << 80
_MOVING = {1: True, 0: False, -1: None}


class PredictedUnderflow(NamedTuple):
    """A moment when the controller needed a set point, but the buffer of the model was empty.

    Attributes:
        time: Time when the controller needed a set point, ns since 1970.
        late_frame: Frame number of the set point that arrived too late.
        late_ms: Time from `time` to the arrival of the late set point, ms.
        moving: Whether the robot was moving: the two set points before `time` differ. None if unknown.
    """

    time: int
    last_frame: int
    late_frame: int
    missed_ticks: int
    late_ms: float
    moving: bool | None


@dataclass(frozen=True, slots=True)
class BufferFacts:
    """What the model predicts, and what the controller reported, about the controller's buffer.

    Attributes:
        slots: Maximum number of set points that the buffer can hold.
        overwrites: Whether a new set point replaces the set point that waits in the buffer. If so, an empty
            buffer is not an error.
        replies_pace: Whether the controller delays each reply until the buffer has room.
        underflows: Number of predicted underflows, without `possible_underflows`.
        underflows_in_motion: Number of predicted underflows while the robot was moving; an underflow at
            standstill is harmless.
        underflow_list: The first predicted underflows.
        possible_underflows: Number of set points that were at most one period late in the model, and may
            still have reached the controller in time.
        overflows: Number of set points that arrived while the model's buffer was certainly full.
        overflow_frames: Frame numbers of the set points that caused the first predicted overflows.
        overwritten: Number of set points that were replaced before the controller took them; 0 if
            `overwrites` is False.
        smallest_level: Smallest number of set points in the buffer when a set point arrived; None for fewer
            than two set points.
        smallest_slack_ms: Smallest slack of a set point: how many ms longer the buffer would have lasted
            without this set point; negative if the buffer was already empty.
        smallest_slack_frame: Frame number of the set point with the smallest slack.
        reported_underflows: Frame numbers of the first replies that report an underflow (0x84201482).
        reported_overflows: Frame numbers of the first replies that report an overflow (0x83201483).
        reported_full: Frame numbers of the first replies with S_BUF_FULL.
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
    """Return the time in ms for which a full buffer lasts without a new set point: one period per slot. For a
    buffer with one slot, this time is two periods, because the controller first executes the previous set
    point, which has already left the slot.
    """
    return float(max(slots, 2) * PERIOD_MS)


@dataclass(frozen=True, slots=True)
class BufferBehaviour:
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


class BufferModel:
    """Predicts how many set points the buffer held when each set point arrived."""

    def __init__(self, behaviour: BufferBehaviour, origin: int) -> None:
        self._behaviour = behaviour
        self._origin = origin
        self._capacity_ns = behaviour.slots * _PERIOD
        # An overflow is certain only above this limit, because the model does not know when in a period the
        # controller takes set points. If the controller sets the pace, the buffer never overflows.
        self._most_excess_ns = (
            _PERIOD if behaviour.overwrites else _NEVER if behaviour.replies_pace else 2 * _PERIOD
        )
        self._excess_ns = 0  # time in ns by which set points exceed the capacity of the buffer
        self._empty_at = 0  # time when the controller will find the buffer empty if no set point arrives
        self._last_frame = 0  # frame number of the last set point that was added
        self._underflows: list[PredictedUnderflow] = []
        self._underflow_count = self._underflows_in_motion = self._possible_underflows = 0
        self._overflows: list[int] = []
        self._overflow_count = 0
        self._levels = [0] * (behaviour.slots + 1)
        self._smallest: tuple[int, int] | None = None
        self._underflow_frames: list[int] = []
        self._refused_frames: list[int] = []
        self._full_frames: list[int] = []

    def add(self, rows: SetPointTable, moving: NDArray[np.int64]) -> NDArray[np.int64]:
        """Add one or more set points. `moving` is 1 if the robot was moving before the set point, 0 if the
        robot stood still, -1 if unknown. Return the slack of each set point in ns; 0 for the first set point.
        """
        if not self._last_frame:
            self._empty_at = int(rows.arrivals[0])
        # If the controller sets the pace, the controller replies only after the set point is in the buffer.
        in_buffer_by = (
            np.maximum(rows.arrivals, rows.replies) if self._behaviour.replies_pace else rows.arrivals
        )
        slacks = self._add_at_once(rows, in_buffer_by)
        if slacks is None:
            slacks = np.array(self._add_one_by_one(rows, in_buffer_by, moving), np.int64)
        self._update_levels(slacks, rows.frames)
        return slacks

    def _add_at_once(self, rows: SetPointTable, in_buffer_by: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Add several set points in one step, which is faster than one by one. If a set point is late,
        refused or beyond the capacity of the buffer, change nothing and return None.

        Each set point makes the buffer last one period longer, up to the buffer's capacity.
        """
        periods = np.arange(len(in_buffer_by) + 1) * _PERIOD
        latest = in_buffer_by + self._capacity_ns
        gained = np.minimum.accumulate(np.concatenate(((self._empty_at,), latest - periods[1:])))
        empty_at = gained + periods
        slacks = empty_at[:-1] - rows.arrivals
        excess = self._excess_ns + int((gained[:-1] - gained[1:]).sum())
        if rows.codes.any() or (slacks < 0).any() or excess > self._most_excess_ns:
            return None
        self._empty_at = int(empty_at[-1])
        self._excess_ns = excess
        return slacks

    def _add_one_by_one(
        self, rows: SetPointTable, in_buffer_by: NDArray[np.int64], moving: NDArray[np.int64]
    ) -> list[int]:
        slacks: list[int] = []
        keep, full = slacks.append, self._capacity_ns
        empty_at = self._empty_at
        codes, entered = rows.codes.tolist(), in_buffer_by.tolist()
        for index, now in enumerate(rows.arrivals.tolist()):
            slack = empty_at - now
            keep(slack)
            if slack < 0:
                empty_at = self._add_underflow(rows, index, empty_at, _MOVING[int(moving[index])])
            if codes[index]:
                empty_at = self._apply_result_code(rows, index, empty_at)
                continue
            empty_at += _PERIOD
            over = empty_at - entered[index] - full
            if over > 0:
                empty_at -= over
                self._excess_ns += over
                if self._excess_ns > self._most_excess_ns:
                    self._excess_ns -= _PERIOD
                    self._overflow_count += 1
                    _append_bounded(self._overflows, int(rows.frames[index]))
        self._empty_at = empty_at
        return slacks

    def _add_underflow(self, rows: SetPointTable, index: int, empty_at: int, moving: bool | None) -> int:
        """Record that the controller needed the set point of row `index` at the time `empty_at`, but this set
        point arrived later. Return the time after the arrival when the controller next needs a set point.
        """
        late = int(rows.arrivals[index]) - empty_at
        missing = (late - 1) // _PERIOD + 1
        self._excess_ns = 0
        if missing == 1:
            self._possible_underflows += 1
        else:
            self._underflow_count += 1
            self._underflows_in_motion += moving is not False
            if len(self._underflows) < MAX_LISTED:
                after = int(rows.frames[index - 1]) if index else self._last_frame
                before, late_ms = int(rows.frames[index]), late / _NS_PER_MS
                starved = PredictedUnderflow(self._origin + empty_at, after, before, missing, late_ms, moving)
                self._underflows.append(starved)
        return empty_at + missing * _PERIOD

    def _apply_result_code(self, rows: SetPointTable, index: int, empty_at: int) -> int:
        code, reply = int(rows.codes[index]), int(rows.reply_frames[index])
        if code == S_BUF_FULL:
            _append_bounded(self._full_frames, reply)
            self._excess_ns = 0
            return int(rows.arrivals[index]) + self._capacity_ns
        if code == E_SLAVE_OVERFLOW:
            _append_bounded(self._refused_frames, reply)
            self._excess_ns = 0
        elif code == E_SLAVE_UNDERFLOW:
            _append_bounded(self._underflow_frames, reply)
        return empty_at if is_failure(code) else empty_at + _PERIOD

    def _update_levels(self, slacks: NDArray[np.int64], frames: NDArray[np.int64]) -> None:
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
