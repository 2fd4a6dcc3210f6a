"""The controller's time: that of this machine, less what this program got no processor for.

A real controller never waits for a processor. Where we had none while something was due or a request lay in
our socket, our time stands still from then on until we have: else 8 ms would go by before the reply is sent
that asks the client for its next set point. What came meanwhile is heard as of when it came, which the system
tells, however late we look: a set point that lay in our socket in time is in time, one that did not is not.
Where clients wait for no reply they go on meanwhile, and so does our time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

STALL_NS = 1_000_000
"""ns behind what was due, or has come, that are the way of the world; more, and we got no processor."""


class ClockedModel(Protocol):
    """Whose time it is, such as a `Simulator`."""

    @property
    def runs_in_real_time(self) -> bool: ...
    @property
    def has_running_calls(self) -> bool: ...
    def due(self, now: int) -> int | None: ...


class SimulatorClock:
    """Tells the time; all times are ns, and none that is told to the simulator goes back.

    Attributes:
        latest_time: the latest time that the simulator was told.
        paused_ns: for how long in all.
    """

    def __init__(
        self,
        model: ClockedModel,
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """Begin with the time of `monotonic`; `wall` is the clock that tells when something came."""
        self.latest_time = 0
        self.paused_ns = 0
        self._model = model
        self._monotonic = monotonic
        self._wall = wall
        self._updated_at = monotonic()
        self._pause_began = self._pause_ended = self._paused_at = (
            0  # the last pause: from when to when by our clock, at what time
        )

    def now(self) -> int:
        """Return the time."""
        return self._monotonic() - self.paused_ns

    def update(self) -> int:
        """Return the time; if something has been due for long, it stood still from then on."""
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
        """Return what the time was when a request came, by the system's clock; it may have stood still since.

        Not if a call waits for time to pass: what comes then is most likely that call again.
        Of several pauses only the last is known: what came before it is looked at soon behind it.
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
            self._pause(
                self._pause_began if self._pause_began <= moment < self._pause_ended else moment,
                ours,
                time_then,
            )
        return time_then

    def _pause(self, since: int, until: int, at: int) -> None:
        """Note that the time stood still."""
        self._pause_began, self._pause_ended, self._paused_at = since, until, at
        self.paused_ns = until - at
        self._updated_at = at

    def make_monotonic(self, now: int) -> int:
        """Return a time that the simulator is told: `now`, or `latest_time` if that is later."""
        self.latest_time = max(self.latest_time, now)
        return self.latest_time

    def on_replies_sent(self) -> None:
        """Note that all is sent that follows from what was told; since the last look that took no time."""
        ours = self._monotonic()
        if ours - self.paused_ns - self._updated_at > STALL_NS and not self._model.runs_in_real_time:
            self._pause(self._updated_at + self.paused_ns, ours, self._updated_at)
