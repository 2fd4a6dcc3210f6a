"""Spare file descriptors, so that a stop request can still connect when all other descriptors are in use."""

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


def is_out_of_descriptors(error: OSError) -> bool:
    """Return whether an error means that the process or the system has no free file descriptor."""
    return error.errno in (errno.EMFILE, errno.ENFILE)


def wait_readable(descriptor: int, seconds: float) -> bool:
    """Return whether a descriptor becomes readable within `seconds`, without opening another descriptor.
    `poll` allows descriptors beyond the limit of `select`.
    """
    if not hasattr(select, "poll"):
        return bool(select.select([descriptor], (), (), seconds)[0])
    poller = select.poll()
    poller.register(descriptor, select.POLLIN)
    return bool(poller.poll(math.ceil(seconds * 1e3)))


def accept_connection(
    listener: socket.socket, free_descriptor: Callable[[], bool]
) -> tuple[socket.socket, Any] | None:
    """Accept a connection; None if no connection is pending. Raises OSError if accepting fails.

    If no file descriptor is free, `free_descriptor` closes a descriptor; it returns False if it closed none.
    """
    while True:
        try:
            return listener.accept()
        except (BlockingIOError, ConnectionError):
            return None
        except OSError as error:
            # Linux looks for a free file descriptor before it looks for a pending connection.
            if is_out_of_descriptors(error) and not wait_readable(listener.fileno(), 0):
                return None
            if not is_out_of_descriptors(error) or not free_descriptor():
                raise


def raise_descriptor_limit(count: int) -> None:
    """Raise the descriptor limit of this process to `count`, as far as permitted. On macOS, a process starts
    with a limit of 256.
    """
    if sys.platform == "win32":
        return
    try:
        import resource  # noqa: PLC0415  # Windows lacks the module `resource`
    except ImportError:  # Python cannot load `resource` without a free file descriptor
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = count if hard == resource.RLIM_INFINITY else min(count, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


class SpareDescriptors:
    """Up to `count` spare file descriptors that can be released for a more important connection."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._held: list[int] = []

    def refill(self) -> bool:
        """Open the missing spare descriptors; return whether all of them are open now."""
        with suppress(OSError):
            while len(self._held) < self._count:
                self._held.append(os.open(os.devnull, os.O_RDONLY))
        return len(self._held) == self._count

    def release_one(self, *, keep: int = 0) -> bool:
        """Close a spare descriptor if more than `keep` are open; return whether one was closed."""
        if len(self._held) <= keep:
            return False
        os.close(self._held.pop())
        return True

    def close(self) -> None:
        """Close all spare descriptors. After `close`, `refill` opens no descriptors."""
        self._count = 0
        while self.release_one():
            pass
