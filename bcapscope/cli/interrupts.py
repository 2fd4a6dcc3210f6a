"""Ctrl-C while something endless is read: it ends the wait for more, and nothing else."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import Self, TypeVar

T = TypeVar("T")


class Interrupts:
    """Keeps Ctrl-C from those who work on what was read, so that all of it is still told.

    The first one counts only where more is waited for; a second one, before that is noticed, ends the program
    as ever. To be used in the main thread, which is the one that signals reach.
    """

    def __init__(self) -> None:
        """Take Ctrl-C over."""
        self._waiting = self._asked = False
        self._before = signal.signal(signal.SIGINT, self._take)

    def wait(self, read: Callable[[], T], otherwise: T) -> T:
        """Return what `read` gives; `otherwise` where Ctrl-C came meanwhile, or had come before."""
        if self._asked:
            return otherwise
        try:
            self._waiting = True
            found = read()
            self._waiting = False  # what was read is safe before the block is left
        except KeyboardInterrupt:
            return otherwise
        finally:
            self._waiting = False
        return found

    def close(self) -> None:
        """Give Ctrl-C back."""
        signal.signal(signal.SIGINT, self._before)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, number: int, frame: FrameType | None) -> None:
        again, self._asked = self._asked, True
        if again or self._waiting:
            raise KeyboardInterrupt
