"""The clock of an event loop in nanoseconds, and a loop whose time passes only when nothing else is to do."""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

R = TypeVar("R")


class LoopClock:
    """Tells the time of an event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        """Note how far 1970 is from the beginning of the loop's time."""
        self._loop = loop
        self._epoch = time.time_ns() - self.now()

    def now(self) -> int:
        """Return nanoseconds of a clock that does not go back."""
        return round(self._loop.time() * 1e9)

    def since_1970(self, now: int) -> int:
        """Convert a time of `now` to nanoseconds since 1970-01-01 UTC."""
        return now + self._epoch

    def call_at(self, when: int, callback: Callable[[], None]) -> asyncio.TimerHandle:
        """Call `callback` when `now` has reached `when`."""
        return self._loop.call_at(when / 1e9, callback)


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An event loop that never sleeps: when all wait, its time jumps to the next timer.

    For what meets in memory; a socket would never be waited for.
    """

    def __init__(self) -> None:
        """Begin at time 0."""
        self._virtual_selector = _VirtualTimeSelector()
        super().__init__(self._virtual_selector)

    def time(self) -> float:
        """Return the virtual time in seconds."""
        return self._virtual_selector.seconds


class _VirtualTimeSelector(selectors.SelectSelector):
    """Lets time pass instead of waiting for it."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready:
            return ready
        if timeout is None:
            raise RuntimeError("everything waits, and there is no timer that could end it")
        self.seconds += max(timeout, 0)
        return []


def run_in_virtual_time(coroutine: Coroutine[Any, Any, R]) -> R:
    """Run a coroutine to its end under a `VirtualTimeLoop`."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(coroutine)
