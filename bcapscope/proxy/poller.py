"""Wait for sockets: with epoll where the system has it, otherwise with select."""

from __future__ import annotations

import ctypes
import os
import select
import struct
import sys
import time
from collections.abc import Callable
from typing import TypeAlias

READ, WRITE, ERROR, HANG_UP = 1, 4, 8, 16
"""Bits for the events of a file descriptor, with the same values as in epoll."""

Handler: TypeAlias = Callable[[int], None]
"""Function that handles the events of a file descriptor, as bits such as `READ | WRITE`."""


class SelectPoller:
    """A poller with the interface of `select.epoll`, for systems without epoll."""

    def __init__(self) -> None:
        self._masks: dict[int, int] = {}

    def register(self, descriptor: int, mask: int) -> None:
        self._masks[descriptor] = mask

    modify = register

    def unregister(self, descriptor: int) -> None:
        self._masks.pop(descriptor, None)

    def poll(self, seconds: float | None) -> list[tuple[int, int]]:
        """Return the ready descriptors with their events. A socket with an error counts as ready for writing,
        so that its handler finds the error.
        """
        readers = [each for each, mask in self._masks.items() if mask & READ]
        writers = [each for each, mask in self._masks.items() if mask & WRITE]
        readable, writable, broken = select.select(readers, writers, writers, seconds)
        found = dict.fromkeys(readable, READ)
        for each in (*writable, *broken):
            found[each] = found.get(each, 0) | WRITE
        return list(found.items())

    def close(self) -> None:
        self._masks.clear()


Poller: TypeAlias = "select.epoll | SelectPoller"


def make_poller() -> Poller:
    return select.epoll() if hasattr(select, "epoll") else SelectPoller()


def wait_precisely(poller: Poller, seconds: float) -> list[tuple[int, int]]:
    """Wait like `poller.poll`, but with a resolution of microseconds instead of epoll's milliseconds."""
    if isinstance(poller, SelectPoller):
        return poller.poll(seconds)
    select.select([poller.fileno()], (), (), seconds)
    return poller.poll(0)


def open_ticker(seconds: float) -> int | None:
    """Open a file descriptor that becomes readable every `seconds`; None if the system cannot do this. The
    descriptor wakes up a poll that has no time limit: a time limit lengthened a round trip of 21 µs by 1 µs.
    """
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None)
    descriptor = int(libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
    if descriptor < 0:
        return None
    each = divmod(round(seconds * 1e9), 1_000_000_000)
    libc.timerfd_settime(descriptor, 0, struct.pack("@llll", *each, *each), None)
    return descriptor


class DescriptorWatcher:
    """Calls handlers for events of file descriptors."""

    def __init__(self) -> None:
        self._poller = make_poller()
        self._handlers: dict[int, Handler] = {}
        self._new_handlers: dict[int, Handler] = {}
        self._just_unwatched: set[int] = set()
        self._paused: set[int] = set()

    def watch(self, descriptor: int, handler: Handler, mask: int = READ) -> None:
        """Call `handler` for every event of a file descriptor.

        The system may reuse the number of a closed descriptor while the current poll still reports events of
        the closed descriptor. For a reused number, `handler` is therefore called only after the next poll.
        """
        handlers = self._new_handlers if descriptor in self._just_unwatched else self._handlers
        handlers[descriptor] = handler
        self._poller.register(descriptor, mask)

    def change(self, descriptor: int, mask: int) -> None:
        self._poller.modify(descriptor, mask)

    def unwatch(self, descriptor: int) -> None:
        if self._handlers.pop(descriptor, None) or self._new_handlers.pop(descriptor, None):
            self._just_unwatched.add(descriptor)
            self._paused.discard(descriptor)
            self._poller.unregister(descriptor)

    def pause(self, descriptor: int) -> None:
        self._poller.modify(descriptor, 0)
        self._paused.add(descriptor)

    def _resume_paused(self) -> None:
        while self._paused:
            self._poller.modify(self._paused.pop(), READ)

    def _adopt_new_handlers(self) -> None:
        self._just_unwatched.clear()
        self._handlers.update(self._new_handlers)
        self._new_handlers.clear()
