"""The clock of the simulated controller. The clock stops while this process gets no processor.

On a real controller, no other program delays the replies. The simulator may have to wait while other programs
use the processor. If the clock went on during this wait, a period of 8 ms could end before the simulator
sends the reply that triggers the next set point.

The model processes each frame with the arrival time that the operating system recorded, even if the simulator
reads the frame late. In a slave mode where the client sets the pace, the clock never stops. In such a mode,
the client sends set points without waiting for replies, even while the simulator gets no processor.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

STALL_NS = 1_000_000
"""Longest normal delay in ns with which the simulator processes a due event or an arrived request. If the
delay is longer, the simulated time does not advance during the delay.
"""


class ClockedModel(Protocol):
    @property
    def runs_in_real_time(self) -> bool: ...
    @property
    def has_running_calls(self) -> bool: ...
    def due(self, now: int) -> int | None: ...


class SimulatorClock:
    """The clock, in ns. `latest_time` is the latest time that the clock gave to the simulated controller."""

    def __init__(
        self,
        model: ClockedModel,
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """The simulated time advances with `monotonic`. `wall` returns the current time in ns since 1970."""
        self.latest_time = 0
        self.paused_ns = 0
        self._model = model
        self._monotonic = monotonic
        self._wall = wall
        self._updated_at = monotonic()
        # `_pause_began` and `_pause_ended` limit the newest pause, in `monotonic` time. `_paused_at` is the
        # simulated time at which the clock stood still during this pause.
        self._pause_began = self._pause_ended = self._paused_at = 0

    def now(self) -> int:
        return self._monotonic() - self.paused_ns

    def update(self) -> int:
        """Return the simulated time. If an event is overdue by more than `STALL_NS`, first set the clock back
        to the time at which the event was due. In modes where the client sets the pace, never set the clock
        back.
        """
        ours = self._monotonic()
        now = ours - self.paused_ns
        if now - self._updated_at > STALL_NS and not self._model.runs_in_real_time:
            due = self._model.due(self._updated_at)
            if due is not None and now - due > STALL_NS:
                self._pause(due + self.paused_ns, ours, due)
                now = due
        self._updated_at = now
        return now

    def arrival_time(self, received_at: int) -> int:
        """Convert a request's arrival time from ns since 1970 (`received_at`) to the simulated time.

        If the simulator reads a request more than `STALL_NS` after the arrival, the clock is set back to the
        arrival. While a call runs, the clock is not set back: a request is then usually a retry, which starts
        no new call. In modes where the client sets the pace, the clock is never set back.

        For a request that arrived before the newest pause of the clock, the result ignores
        earlier pauses, because few requests remain unread during two pauses.
        """
        now, ours = self.update(), self._monotonic()
        moment = ours - max(0, self._wall() - received_at)
        if moment >= self._pause_ended:
            time_then = moment - self.paused_ns
        else:
            time_then = self._paused_at - max(0, self._pause_began - moment)
        time_then = max(self.latest_time, time_then)
        if now - time_then > STALL_NS and not (
            self._model.runs_in_real_time or self._model.has_running_calls
        ):
            is_in_pause = self._pause_began <= moment < self._pause_ended
            self._pause(self._pause_began if is_in_pause else moment, ours, time_then)
        return time_then

    def _pause(self, since: int, until: int, at: int) -> None:
        self._pause_began, self._pause_ended, self._paused_at = since, until, at
        self.paused_ns = until - at
        self._updated_at = at

    def make_monotonic(self, now: int) -> int:
        self.latest_time = max(self.latest_time, now)
        return self.latest_time

    def on_replies_sent(self) -> None:
        """If more than `STALL_NS` passed since the clock's last update, set the clock back to this update."""
        ours = self._monotonic()
        if ours - self.paused_ns - self._updated_at > STALL_NS and not self._model.runs_in_real_time:
            self._pause(self._updated_at + self.paused_ns, ours, self._updated_at)
