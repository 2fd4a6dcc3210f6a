"""File descriptors held back, so that a stop still finds some when there are none left."""

from __future__ import annotations

import errno
import math
import os
import select
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

OUT_OF_DESCRIPTORS_TEXT = os.strerror(errno.EMFILE).lower()
"""What the system says when a process has no file descriptors left."""

_OUT_OF_DESCRIPTORS = frozenset({errno.EMFILE, errno.ENFILE})


def is_out_of_descriptors(error: OSError) -> bool:
    """Return whether an error means that the process, or the system, has no file descriptors left."""
    return error.errno in _OUT_OF_DESCRIPTORS


def wait_readable(descriptor: int, seconds: float) -> bool:
    """Wait at most so many seconds for a file descriptor to be readable; return whether it is.

    It takes no file descriptor, and the number of this one may be larger than `select` takes.
    """
    if not hasattr(select, "poll"):
        return bool(select.select([descriptor], (), (), seconds)[0])
    poller = select.poll()
    poller.register(descriptor, select.POLLIN)
    return bool(poller.poll(math.ceil(seconds * 1e3)))


def accept_connection(
    listener: socket.socket, free_descriptor: Callable[[], bool]
) -> tuple[socket.socket, Any] | None:
    """Accept a connection and return it with its address; None if none waits.

    Args:
        listener: does not block.
        free_descriptor: frees a file descriptor and returns whether it could; called when none is left.

    Raises:
        OSError: no connection can be accepted now.
    """
    while True:
        try:
            return listener.accept()
        except (BlockingIOError, ConnectionError):
            return None
        except OSError as error:
            # Linux looks for a file descriptor first, and for a connection after that.
            if is_out_of_descriptors(error) and not wait_readable(listener.fileno(), 0):
                return None
            if not is_out_of_descriptors(error) or not free_descriptor():
                raise


def raise_descriptor_limit(count: int) -> None:
    """Raise the limit of this process to `count`, as far as its user may; macOS gives 256."""
    if sys.platform == "win32":
        return
    try:
        import resource  # noqa: PLC0415  # there is none on Windows
    except ImportError:  # there is no file descriptor left to load it with
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = count if hard == resource.RLIM_INFINITY else min(count, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


class SpareDescriptors:
    """Some file descriptors that can be given up for something that matters more."""

    def __init__(self, count: int) -> None:
        """Prepare to hold back `count`; `refill` takes them."""
        self._count = count
        self._held: list[int] = []

    def refill(self) -> bool:
        """Take back what is missing; return whether all are held now."""
        with suppress(OSError):
            while len(self._held) < self._count:
                self._held.append(os.open(os.devnull, os.O_RDONLY))
        return len(self._held) == self._count

    def release_one(self, *, keep: int = 0) -> bool:
        """Give one up; return whether there were more than `keep`."""
        if len(self._held) <= keep:
            return False
        os.close(self._held.pop())
        return True

    def close(self) -> None:
        """Give all up, for good."""
        self._count = 0
        while self.release_one():
            pass
