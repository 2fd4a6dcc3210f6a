"""The clock of an event loop in ns."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable


class LoopClock:
    """Reads the time of an event loop in ns."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        """Record the difference between the loop's time and the time since 1970-01-01 UTC."""
        self._loop = loop
        self._epoch = time.time_ns() - self.now()

    def now(self) -> int:
        """Return the time on the loop's monotonic clock, ns."""
        return round(self._loop.time() * 1e9)

    def since_1970(self, now: int) -> int:
        return now + self._epoch

    def call_at(self, when: int, callback: Callable[[], None]) -> asyncio.TimerHandle:
        """Schedule `callback` for the time `when` in ns, on the same clock as `now`."""
        return self._loop.call_at(when / 1e9, callback)
