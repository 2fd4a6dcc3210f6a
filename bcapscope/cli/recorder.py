"""A capture of what passes a server, written by a thread of its own, so that no client waits for a disk.

Packets are made by the thread of the server, when the client has its answer: a second thread that makes
packets takes the interpreter from the first, and costs milliseconds. The one here only waits for the disk.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from io import RawIOBase
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from bcapscope.capture.packetfile import is_packet
from bcapscope.capture.recording import Address, Recording
from bcapscope.capture.spool import append
from bcapscope.cli.files import FileRefused
from bcapscope.protocol.wording import counted
from bcapscope.render.escape import printable

MOST_WAITING = 16 << 20
"""Bytes that wait for the disk, what they cost besides included, before packets are left out and counted."""

_COST = 512
"""Bytes of memory that a packet takes besides its own."""

_TICK = 0.02
"""Seconds between looks at what there is to write."""

_TURN = 1_000_000
"""ns in which packets are made, before the server looks whether somebody has a request."""

_ENDS_WITHIN = 5.0
"""Seconds that what is left may take at the end."""

_Step: TypeAlias = Callable[[Recording], None]
_Way: TypeAlias = tuple[Address, Address]


def open_capture(path: Path) -> BinaryIO | RawIOBase:
    """Make a new file for a capture; it has no buffer, so that a kill loses nothing that was written.

    Raises:
        FileRefused: it exists already, or cannot be made.
    """
    try:
        return path.open("xb", buffering=0)
    except OSError as error:
        raise FileRefused(path, (error.strerror or str(error)).lower()) from None


class _Basket(RawIOBase):
    """Where packets are laid down for the other thread to take.

    Attributes:
        blocks: what was written, each time a piece.
        size: of all that was ever written, with `_COST` for each.
    """

    def __init__(self) -> None:
        self.blocks: deque[bytes] = deque()
        self.size = 0

    def write(self, data: Any) -> int:
        """Take a piece."""
        self.blocks.append(bytes(data))
        self.size += len(data) + _COST
        return len(data)


class Recorder:
    """Writes a capture behind the server's back; what there was no time to write is counted and told.

    All but its own thread is done by the thread of the server.
    """

    def __init__(
        self,
        file: BinaryIO | RawIOBase,
        name: str,
        tell: Callable[[str], None],
        *,
        most: int = MOST_WAITING,
    ) -> None:
        """Begin.

        Args:
            file: where to write, not buffered.
            name: of the file, for people.
            tell: takes a sentence, and waits for nobody.
            most: bytes that may wait.
        """
        self._file = file
        self._name = printable(name)
        self._tell = tell
        self._most = most
        self._basket = _Basket()
        self._recording = Recording(self._basket)
        self._steps: deque[tuple[int, _Step]] = deque()
        self._batch: list[bytes] = []
        self._held = self._written = 0
        self._missing = self._lost = 0
        self._ways: set[_Way] = set()
        self._gaps: dict[_Way, int] = {}
        self._late: list[_Step] = []
        self._failed = False
        self._news, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()
        self._news.set()

    def datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Record a UDP datagram."""
        if self._has_room(len(data)):
            comment = self._resume()
            self._add(
                len(data), lambda recording: recording.datagram(source, target, data, time, comment=comment)
            )

    def segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Record bytes of a TCP connection."""
        way = (source, target)
        if self._has_room(len(data)):
            comment = self._resume()
            self._ways.add(way)
            self._add(
                len(data), lambda recording: recording.segment(source, target, data, time, comment=comment)
            )
        elif way in self._ways:
            self._gaps[way] = self._gaps.get(way, 0) + len(data)

    def finished(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        """Record that an end of a TCP connection, of which there is anything, has ended it."""
        if not self._ways.isdisjoint(((source, target), (target, source))) and self._has_room(0):
            comment = self._resume()
            self._add(
                0,
                lambda recording: recording.finished(source, target, time, reset=reset, comment=comment),
            )

    def ended(self, client: Address, server: Address) -> None:
        """Forget a TCP connection."""
        ways = {(client, server), (server, client)} & self._ways
        if not ways or self._failed:
            return
        self._ways -= ways
        for way in ways:
            self._gaps.pop(way, None)

        def forget(recording: Recording) -> None:
            recording.ended(client, server)

        if self._missing:
            self._late.append(forget)
        else:
            self._add(0, forget)

    def idle(self) -> bool:
        """Make packets of what was taken, and let the thread write them; called when all are answered.

        Returns:
            Whether there is more of it, and it should be called again soon.
        """
        return self._make(_TURN)

    def _make(self, most: int) -> bool:
        """Make packets for so many ns; return whether there is more to do."""
        steps = self._steps
        if not steps:
            return False
        until = time.monotonic_ns() + most
        while steps and time.monotonic_ns() < until:
            size, step = steps.popleft()
            self._held -= size
            step(self._recording)
        if not self._news.is_set():
            self._news.set()
        return bool(steps)

    def close(self) -> bool:
        """Write what is left, if the disk takes it soon; tell whether nothing is missing."""
        self._make(round(_ENDS_WITHIN * 1e9))
        self._over.set()
        self._news.set()
        self._thread.join(_ENDS_WITHIN)
        if not self._thread.is_alive():
            self._file.close()
        elif not self._failed:
            self._lost += sum(map(is_packet, (*self._batch, *self._basket.blocks)))
        self._lost += len(self._steps)
        self._lost += self._missing
        if self._lost:
            self._tell(f"{self._name} lacks {counted(self._lost, 'packet')}: it was not written fast enough")
        return not self._lost and not self._failed

    def _has_room(self, size: int) -> bool:
        if self._failed:
            return False
        waiting = self._held + self._basket.size - self._written
        # Once packets are missing, half of the room must be free: rather one long gap than many short ones.
        if waiting + size + _COST <= (self._most // 2 if self._missing else self._most):
            return True
        if not self._missing and not self._lost:
            self._tell(f"{self._name} is not written fast enough: packets are missing in it from now on")
        self._missing += 1
        return False

    def _resume(self) -> str:
        """Go on behind packets that are missing; return what is to be noted with the next one."""
        if not self._missing:
            return ""
        missing, self._missing = self._missing, 0
        self._lost += missing
        steps = self._late, self._gaps
        self._late, self._gaps = [], {}
        self._add(0, lambda recording: _skip(recording, *steps))
        return f"{counted(missing, 'packet')} before this one could not be written in time"

    def _add(self, size: int, step: _Step) -> None:
        self._steps.append((size + _COST, step))
        self._held += size + _COST

    def _run(self) -> None:
        blocks, size = self._basket.blocks, 0
        try:
            while not self._over.is_set() or blocks:
                self._news.wait()
                self._news.clear()
                self._batch = [blocks.popleft() for _ in range(len(blocks))]
                data = b"".join(self._batch)
                append(self._file, data)
                size += len(data)
                self._written += len(data) + len(self._batch) * _COST
                self._batch = []
                self._over.wait(_TICK)
        except OSError as error:
            self._failed = True
            with suppress(OSError):
                self._file.truncate(size)  # so that it ends with a whole packet
            self._tell(f"{self._name} is not written any more: {(error.strerror or str(error)).lower()}")
            blocks.clear()


def _skip(recording: Recording, late: list[_Step], gaps: dict[_Way, int]) -> None:
    for step in late:
        step(recording)
    for way, size in gaps.items():
        recording.skipped(*way, size)
