"""The clock of an event loop in ns."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable


class LoopClock:
    """A clock in ns. `now` and `call_at` use the monotonic clock of the event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._epoch = time.time_ns() - self.now()

    def now(self) -> int:
        return round(self._loop.time() * 1e9)

    def since_1970(self, now: int) -> int:
        return now + self._epoch

    def call_at(self, when: int, callback: Callable[[], None]) -> asyncio.TimerHandle:
        return self._loop.call_at(when / 1e9, callback)
