"""Ctrl-C while something endless is read: it ends the wait for more, and nothing else."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import Self, TypeVar

T = TypeVar("T")


class DeferredInterrupts:
    """Keeps Ctrl-C from those who work on what was read, so that all of it is still told.

    The first one counts only where more is waited for; a second one, before that is noticed, ends the program
    as ever. To be used in the main thread, which is the one that signals reach.
    """

    def __init__(self) -> None:
        """Take Ctrl-C over."""
        self._is_waiting = self._is_interrupted = False
        self._previous_handler = signal.signal(signal.SIGINT, self._on_sigint)

    def read_or_stop(self, read: Callable[[], T], default: T) -> T:
        """Return what `read` gives; `default` where Ctrl-C came meanwhile, or had come before."""
        if self._is_interrupted:
            return default
        try:
            self._is_waiting = True
            found = read()
            self._is_waiting = False  # what was read is safe before the block is left
        except KeyboardInterrupt:
            return default
        finally:
            self._is_waiting = False
        return found

    def close(self) -> None:
        """Give Ctrl-C back."""
        signal.signal(signal.SIGINT, self._previous_handler)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _on_sigint(self, number: int, frame: FrameType | None) -> None:
        again, self._is_interrupted = self._is_interrupted, True
        if again or self._is_waiting:
            raise KeyboardInterrupt
