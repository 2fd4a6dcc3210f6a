"""Handles Ctrl-C while bcapscope reads an endless input."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import TypeVar

T = TypeVar("T")


class DeferredInterrupts:
    """Delays Ctrl-C while input is processed, so that bcapscope still prints everything that it has read.

    SIGTERM is delayed like Ctrl-C, because scripts end a background program with SIGTERM. The first signal
    takes effect only while the program waits for input. A second signal takes effect at once. Create the
    object in the main thread, because only the main thread handles signals.
    """

    def __init__(self) -> None:
        self._is_waiting = self._is_interrupted = False
        self._previous_handlers = {
            number: signal.signal(number, self._on_signal) for number in (signal.SIGINT, signal.SIGTERM)
        }

    def read_or_stop(self, read: Callable[[], T]) -> T | None:
        """Call `read` and return its result; None if the user pressed Ctrl-C before or during the call."""
        if self._is_interrupted:
            return None
        try:
            self._is_waiting = True
            found = read()
            self._is_waiting = False  # from now on, Ctrl-C does not discard the result
        except KeyboardInterrupt:
            return None
        finally:
            self._is_waiting = False
        return found

    def do_while_waiting(self, work: Callable[[], object]) -> None:
        """Call `work` while `read` waits for input. After `work`, raise KeyboardInterrupt if the user has
        pressed Ctrl-C. `read_or_stop` handles this exception.
        """
        self._is_waiting = False
        work()
        self._is_waiting = True
        if self._is_interrupted:
            raise KeyboardInterrupt

    def close(self) -> None:
        for number, handler in self._previous_handlers.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        again, self._is_interrupted = self._is_interrupted, True
        if again or self._is_waiting:
            raise KeyboardInterrupt
