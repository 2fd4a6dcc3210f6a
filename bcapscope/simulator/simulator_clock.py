"""The controller's time: the machine's time, stopped while this process gets no processor.

A real controller never waits for a processor. An event may become due, or a request may arrive, while this
process gets no processor. The model's time then stands still until the process runs again. If the model's
time continued, 8 ms would pass before the simulator sends the reply that asks the client for its next set
point.

A frame that arrives during this delay is processed with its arrival time, which the operating system records.
A set point that arrived in time therefore counts as in time, however late the simulator reads it. If a client
does not wait for replies, it continues during this delay. In this case, the model's time continues.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

STALL_NS = 1_000_000
"""Longest delay in ns that counts as normal. The delay begins at a due time, or at the arrival of a request.
A longer delay means that this process got no processor.
"""


class ClockedModel(Protocol):
    """Interface of a model that a `SimulatorClock` serves, such as a `Simulator`."""

    @property
    def runs_in_real_time(self) -> bool: ...
    @property
    def has_running_calls(self) -> bool: ...
    def due(self, now: int) -> int | None: ...


class SimulatorClock:
    """The model's clock, in ns. `latest_time` is the time that the clock gave to the model most recently. The
    model never gets an earlier time than that.
    """

    def __init__(
        self,
        model: ClockedModel,
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """The clock follows `monotonic`; arrival times are times of the clock `wall`."""
        self.latest_time = 0
        self.paused_ns = 0
        self._model = model
        self._monotonic = monotonic
        self._wall = wall
        self._updated_at = monotonic()
        # The last pause: its start and end by the machine's clock, and the model's time during the pause.
        self._pause_began = self._pause_ended = self._paused_at = 0

    def now(self) -> int:
        return self._monotonic() - self.paused_ns

    def update(self) -> int:
        """Return the model's time. If an event is long overdue, first set the time back to the due time."""
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
        """Return the model's time at which a request arrived; `received_at` is in ns since 1970.

        If the request waited too long to be read, the model's time goes back to the request's arrival. While
        a call runs, the time does not go back, because the request is most likely a retry of the running
        call. Only the last pause is stored, because the simulator reads requests soon after they arrive.
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
        """Return the later of `now` and `latest_time`, so that the model's time never goes back."""
        self.latest_time = max(self.latest_time, now)
        return self.latest_time

    def on_replies_sent(self) -> None:
        """If sending replies took too long, set the model's time back to the last update."""
        ours = self._monotonic()
        if ours - self.paused_ns - self._updated_at > STALL_NS and not self._model.runs_in_real_time:
            self._pause(self._updated_at + self.paused_ns, ours, self._updated_at)
