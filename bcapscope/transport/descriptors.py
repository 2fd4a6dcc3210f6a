"""File descriptors held back, so that a stop still finds some when there are none left."""

from __future__ import annotations

import errno
import os
from contextlib import suppress

NO_DESCRIPTORS = os.strerror(errno.EMFILE).lower()
"""What the system says when a process has no file descriptors left."""

_NONE_LEFT = frozenset({errno.EMFILE, errno.ENFILE})


def none_left(error: OSError) -> bool:
    """Tell whether an error means that the process, or the system, has no file descriptors left."""
    return error.errno in _NONE_LEFT


class SpareDescriptors:
    """Some file descriptors that can be given up for something that matters more."""

    def __init__(self, count: int) -> None:
        """Hold back as many of `count` as the system gives."""
        self._count = count
        self._held: list[int] = []
        self.fill()

    def fill(self) -> bool:
        """Take back what is missing; tell whether all are held now."""
        with suppress(OSError):
            while len(self._held) < self._count:
                self._held.append(os.open(os.devnull, os.O_RDONLY))
        return len(self._held) == self._count

    def give(self) -> bool:
        """Give one up; tell whether there was one."""
        if not self._held:
            return False
        os.close(self._held.pop())
        return True

    def close(self) -> None:
        """Give all up, for good."""
        self._count = 0
        while self.give():
            pass
