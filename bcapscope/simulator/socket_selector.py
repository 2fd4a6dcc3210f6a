"""Waiting for sockets that are readable or writable."""

from __future__ import annotations

import select
from collections.abc import Sequence
from typing import TypeAlias

ReadyDescriptors: TypeAlias = tuple[list[int], list[int]]
"""Readable file descriptors, and writable file descriptors."""


class SocketSelector:
    """Polls file descriptors, or waits for them; regular files, which stdin may be, are always ready.

    `epoll`, which the proxy's relay uses, refuses regular files. A wait with microsecond precision also takes
    two steps with `epoll`.
    """

    def __init__(self, readers: Sequence[int], writers: Sequence[int]) -> None:
        """Watch these file descriptors; another set of descriptors needs another selector."""
        self.readers = readers
        self.writers = writers
        self._poll = select.poll() if hasattr(select, "poll") else None
        if self._poll is not None:
            for reader in readers:
                self._poll.register(reader, select.POLLIN)
            for writer in writers:
                self._poll.register(writer, select.POLLOUT)

    def ready_now(self) -> ReadyDescriptors:
        """Return the descriptors that are ready now; if none is, `poll` takes half the time of `select`."""
        if self._poll is None:
            return self.wait(0)
        found = self._poll.poll(0)
        if not found:
            return [], []
        ready = [descriptor for descriptor, _ in found]
        writable = [each for each in ready if each in self.writers]
        return ([each for each in ready if each not in writable] if writable else ready), writable

    def wait(self, seconds: float) -> ReadyDescriptors:
        """Return the descriptors that are ready, after `seconds` at the latest.

        `select` waits with the microsecond precision that modes on the 8 ms grid need; `poll` does not.
        """
        readable, writable, _ = select.select(self.readers, self.writers, (), seconds)
        return readable, writable
