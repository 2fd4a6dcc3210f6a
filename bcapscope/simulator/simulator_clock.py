"""The controller's time: the machine's time, stopped while this process gets no processor.

A real controller never waits for a processor. If this process gets none while something is due or a request
is in its socket, the model's time stands still until it runs again. Otherwise 8 ms would pass before the
simulator sends the reply that asks the client for its next set point.

A frame that arrived meanwhile counts from its arrival, which the operating system records. So a set point
that arrived in time is in time, however late the simulator reads it, and a late one is late. Clients that do
not wait for replies go on meanwhile, and then the model's time goes on too.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

STALL_NS = 1_000_000
"""Delay, ns, behind a due time or an arrival that is normal; a longer one means a lack of processor time."""


class ClockedModel(Protocol):
    """A model that uses the clock, such as a `Simulator`."""

    @property
    def runs_in_real_time(self) -> bool: ...
    @property
    def has_running_calls(self) -> bool: ...
    def due(self, now: int) -> int | None: ...


class SimulatorClock:
    """The model's clock. All times are ns; the times that the model receives never go back.

    Attributes:
        latest_time: The latest time that the model received.
        paused_ns: Total length of all pauses.
    """

    def __init__(
        self,
        model: ClockedModel,
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """Begin with the time of `monotonic`; `wall` is the clock of the arrival times."""
        self.latest_time = 0
        self.paused_ns = 0
        self._model = model
        self._monotonic = monotonic
        self._wall = wall
        self._updated_at = monotonic()
        # The last pause: begin and end by the machine's clock, and the model's time meanwhile.
        self._pause_began = self._pause_ended = self._paused_at = 0

    def now(self) -> int:
        return self._monotonic() - self.paused_ns

    def update(self) -> int:
        """Return the model's time; if something is overdue too long, the time pauses from its due time."""
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
        """Return the model's time when a request arrived; `received_at` is ns since 1970.

        If the request waited too long, the model's time pauses from its arrival. It does not pause while a
        call waits for time to pass: then the request is most likely a retry of that call. Only the last of
        several pauses is known; requests that arrived before it are read soon after it.
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
        """Note a pause of the model's time."""
        self._pause_began, self._pause_ended, self._paused_at = since, until, at
        self.paused_ns = until - at
        self._updated_at = at

    def make_monotonic(self, now: int) -> int:
        """Return the later of `now` and `latest_time`, for the model."""
        self.latest_time = max(self.latest_time, now)
        return self.latest_time

    def on_replies_sent(self) -> None:
        """Note that all replies are sent; if that took too long, the time pauses from the last update."""
        ours = self._monotonic()
        if ours - self.paused_ns - self._updated_at > STALL_NS and not self._model.runs_in_real_time:
            self._pause(self._updated_at + self.paused_ns, ours, self._updated_at)
