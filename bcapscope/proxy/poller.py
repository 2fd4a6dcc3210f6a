"""Waiting for sockets: epoll where there is one, else select."""

from __future__ import annotations

import ctypes
import os
import select
import struct
import sys
import time
from typing import Protocol

READ, WRITE, ERROR, HANG_UP = 1, 4, 8, 16
"""Bits of what is waited for and of what happened, those of epoll."""


class Poller(Protocol):
    """Knows for each file descriptor what is waited for."""

    def register(self, descriptor: int, mask: int, /) -> object:
        """Begin to wait."""

    def modify(self, descriptor: int, mask: int, /) -> object:
        """Wait for something else."""

    def unregister(self, descriptor: int, /) -> object:
        """Wait no more."""

    def poll(self, seconds: float | None, /) -> list[tuple[int, int]]:
        """Return what happened, at the latest after so many seconds, if there is a limit."""

    def close(self) -> object:
        """Let go."""


class SelectPoller:
    """The same with select, for systems without epoll."""

    def __init__(self) -> None:
        self._masks: dict[int, int] = {}

    def register(self, descriptor: int, mask: int) -> None:
        """Begin to wait."""
        self._masks[descriptor] = mask

    modify = register

    def unregister(self, descriptor: int) -> None:
        """Wait no more."""
        self._masks.pop(descriptor, None)

    def poll(self, seconds: float | None) -> list[tuple[int, int]]:
        """Return what happened; what went wrong on a socket shows when it is read or written."""
        readers = [each for each, mask in self._masks.items() if mask & READ]
        writers = [each for each, mask in self._masks.items() if mask & WRITE]
        readable, writable, broken = select.select(readers, writers, writers, seconds)
        found = dict.fromkeys(readable, READ)
        for each in (*writable, *broken):
            found[each] = found.get(each, 0) | WRITE
        return list(found.items())

    def close(self) -> None:
        """Let go."""
        self._masks.clear()


def make_poller() -> Poller:
    """Return the best that the system has."""
    return select.epoll() if hasattr(select, "epoll") else SelectPoller()


def wait_precisely(poller: Poller, seconds: float) -> list[tuple[int, int]]:
    """Wait as `poll` does, to the microsecond: epoll alone counts milliseconds."""
    if isinstance(poller, SelectPoller):
        return poller.poll(seconds)
    assert isinstance(poller, select.epoll)
    select.select([poller.fileno()], (), (), seconds)
    return poller.poll(0)


def open_ticker(seconds: float) -> int | None:
    """Open a file descriptor that can be read every so many seconds; None where there is no such thing.

    Waiting with a limit sets a timer each time, which costs microseconds; this one is set once.
    """
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor = int(libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
    if descriptor < 0:
        return None
    each = divmod(round(seconds * 1e9), 1_000_000_000)
    libc.timerfd_settime(descriptor, 0, struct.pack("@llll", *each, *each), None)
    return descriptor
