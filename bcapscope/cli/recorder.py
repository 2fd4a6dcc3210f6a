"""A capture of what passes a server, written by a thread of its own, so that no client waits for a disk."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from io import RawIOBase
from pathlib import Path
from typing import BinaryIO, TypeAlias

from bcapscope.capture.recording import Address, Recording
from bcapscope.cli.files import FileRefused
from bcapscope.render.call import counted
from bcapscope.render.escape import printable

MOST_WAITING = 16 << 20
"""Bytes that wait for the disk, what they cost besides included, before packets are left out and counted."""

_COST = 512
"""Bytes of memory that a packet takes besides its own."""

_TICK = 0.02
"""Seconds between looks at what there is to write: each takes the interpreter from the server for a while."""

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
        self._steps: deque[tuple[int, _Step]] = deque()
        self._taken = self._written = 0
        self._missing = self._lost = 0
        self._ways: set[_Way] = set()
        self._gaps: dict[_Way, int] = {}
        self._late: list[_Step] = []
        self._failed = False
        self._news, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

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

    def ended(self, client: Address, server: Address) -> None:
        """Forget a TCP connection."""
        ways = {(client, server), (server, client)} & self._ways
        if not ways or self._failed:
            return
        self._ways -= ways
        for way in ways:
            self._gaps.pop(way, None)
        forget: _Step = lambda recording: recording.ended(client, server)  # noqa: E731 - as its neighbours
        if self._missing:
            self._late.append(forget)
        else:
            self._add(0, forget)

    def idle(self) -> None:
        """Let the thread write what there is; called when nobody waits for an answer."""
        if self._steps and not self._news.is_set():
            self._news.set()

    def close(self) -> bool:
        """Write what is left, if the disk takes it soon; tell whether nothing is missing."""
        self._over.set()
        self._news.set()
        self._thread.join(_ENDS_WITHIN)
        if not self._thread.is_alive():
            self._file.close()
        elif not self._failed:
            self._lost += len(self._steps)
        self._lost += self._missing
        if self._lost:
            self._tell(f"{self._name} lacks {counted(self._lost, 'packet')}: it was not written fast enough")
        return not self._lost and not self._failed

    def _has_room(self, size: int) -> bool:
        if self._failed:
            return False
        waiting = self._taken - self._written
        # Once packets are missing, half of the room must be free: rather one long gap than many short ones.
        if waiting + size + _COST <= (self._most // 2 if self._missing else self._most):
            return True
        if not self._missing:
            self._tell(f"{self._name} is not written fast enough: what passes now is missing in it")
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
        self._taken += size + _COST

    def _run(self) -> None:
        try:
            recording = Recording(self._file)
            while not self._over.is_set() or self._steps:
                self._news.wait()
                self._news.clear()
                while self._steps:
                    size, step = self._steps[0]
                    step(recording)
                    self._steps.popleft()
                    self._written += size
                self._over.wait(_TICK)
        except OSError as error:
            self._failed = True
            reason = (error.strerror or str(error)).lower()
            self._tell(f"{self._name} is not written any more: {reason}")
            self._steps.clear()


def _skip(recording: Recording, late: list[_Step], gaps: dict[_Way, int]) -> None:
    for step in late:
        step(recording)
    for way, size in gaps.items():
        recording.skipped(*way, size)
