"""Ctrl-C while an endless input is read: it ends the wait for more input, and nothing else."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import Self, TypeVar

T = TypeVar("T")


class DeferredInterrupts:
    """Delays Ctrl-C while input is processed, so that everything that was read is still printed.

    The first Ctrl-C takes effect only while the program waits for input. A second one ends the program as
    usual, if it comes before the first took effect. Use it in the main thread, which receives signals.
    """

    def __init__(self) -> None:
        self._is_waiting = self._is_interrupted = False
        self._previous_handler = signal.signal(signal.SIGINT, self._on_sigint)

    def read_or_stop(self, read: Callable[[], T]) -> T | None:
        """Return the result of `read`, or None if Ctrl-C came meanwhile or before."""
        if self._is_interrupted:
            return None
        try:
            self._is_waiting = True
            found = read()
            self._is_waiting = False  # keep the result even if Ctrl-C comes right after
        except KeyboardInterrupt:
            return None
        finally:
            self._is_waiting = False
        return found

    def close(self) -> None:
        signal.signal(signal.SIGINT, self._previous_handler)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _on_sigint(self, number: int, frame: FrameType | None) -> None:
        again, self._is_interrupted = self._is_interrupted, True
        if again or self._is_waiting:
            raise KeyboardInterrupt
