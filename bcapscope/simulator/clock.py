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

HELD_UP = 1_000_000
"""ns behind what was due, or has come, that are the way of the world; more, and we got no processor."""


class Timed(Protocol):
    """Whose time it is, such as a `Simulator`."""

    @property
    def keeps_time(self) -> bool: ...
    @property
    def waits(self) -> bool: ...
    def due(self, now: int) -> int | None: ...


class Clock:
    """Tells the time; all times are ns, and none that is told to the simulator goes back.

    Attributes:
        heard: the latest time that the simulator was told.
        stood_still: for how long in all.
    """

    def __init__(
        self,
        timed: Timed,
        ours: Callable[[], int] = time.monotonic_ns,
        system: Callable[[], int] = time.time_ns,
    ) -> None:
        """Begin with the time of `ours`; `system` is the clock that tells when something came."""
        self.heard = 0
        self.stood_still = 0
        self._timed = timed
        self._ours = ours
        self._system = system
        self._looked = ours()
        self._since = self._until = self._at = (
            0  # the last pause: from when to when by our clock, at what time
        )

    def now(self) -> int:
        """Return the time."""
        return self._ours() - self.stood_still

    def look(self) -> int:
        """Return the time; if something has been due for long, it stood still from then on."""
        ours = self._ours()
        now = ours - self.stood_still
        if now - self._looked > HELD_UP and not self._timed.keeps_time:
            due = self._timed.due(self._looked)
            if due is not None and now - due > HELD_UP:
                self._pause(due + self.stood_still, ours, due)
                now = due
        self._looked = now
        return now

    def as_of(self, came: int) -> int:
        """Return what the time was when a request came, by the system's clock; it may have stood still since.

        Not if a call waits for time to pass: what comes then is most likely that call again.
        Of several pauses only the last is known: what came before it is looked at soon behind it.
        """
        now, ours = self.look(), self._ours()
        moment = ours - max(0, self._system() - came)
        if moment >= self._until:
            time_then = moment - self.stood_still
        else:
            time_then = self._at - max(0, self._since - moment)
        time_then = max(self.heard, time_then)
        if now - time_then > HELD_UP and not (self._timed.keeps_time or self._timed.waits):
            self._pause(self._since if self._since <= moment < self._until else moment, ours, time_then)
        return time_then

    def _pause(self, since: int, until: int, at: int) -> None:
        """Note that the time stood still."""
        self._since, self._until, self._at = since, until, at
        self.stood_still = until - at
        self._looked = at

    def tell(self, now: int) -> int:
        """Return a time that the simulator is told: `now`, or `heard` if that is later."""
        self.heard = max(self.heard, now)
        return self.heard

    def answered(self) -> None:
        """Note that all is sent that follows from what was told; since the last look that took no time."""
        ours = self._ours()
        if ours - self.stood_still - self._looked > HELD_UP and not self._timed.keeps_time:
            self._pause(self._looked + self.stood_still, ours, self._looked)
