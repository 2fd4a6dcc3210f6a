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

from bcapscope.capture.append_log import write_all
from bcapscope.capture.pcapng_writer import is_packet_block
from bcapscope.capture.socket_recording import Address, SocketRecording
from bcapscope.errors import FileWriteError
from bcapscope.protocol.text_format import counted
from bcapscope.render.escape import printable

MAX_WAITING = 16 << 20
"""Bytes that wait for the disk, what they cost besides included, before packets are left out and counted."""

_PACKET_OVERHEAD = 512
"""Bytes of memory that a packet takes besides its own."""

_WRITE_INTERVAL = 0.02
"""Seconds between looks at what there is to write."""

_MAKE_FOR_NS = 1_000_000
"""ns in which packets are made, before the server looks whether somebody has a request."""

_ENDS_WITHIN = 5.0
"""Seconds that what is left may take at the end."""

_WriteStep: TypeAlias = Callable[[SocketRecording], None]
_Direction: TypeAlias = tuple[Address, Address]


def create_capture(path: Path) -> BinaryIO | RawIOBase:
    """Make a new file for a capture; it has no buffer, so that a kill loses nothing that was written.

    Raises:
        FileWriteError: it exists already, or cannot be made.
    """
    try:
        return path.open("xb", buffering=0)
    except OSError as error:
        raise FileWriteError(path, (error.strerror or str(error)).lower()) from None


class _BlockBuffer(RawIOBase):
    """Where packets are laid down for the other thread to take.

    Attributes:
        blocks: what was written, each time a piece.
        size: of all that was ever written, with `_PACKET_OVERHEAD` for each.
    """

    def __init__(self) -> None:
        self.blocks: deque[bytes] = deque()
        self.size = 0

    def write(self, data: Any) -> int:
        """Take a piece."""
        self.blocks.append(bytes(data))
        self.size += len(data) + _PACKET_OVERHEAD
        return len(data)


class ServerRecorder:
    """Writes a capture behind the server's back; what there was no time to write is counted and told.

    All but its own thread is done by the thread of the server.
    """

    def __init__(
        self,
        file: BinaryIO | RawIOBase,
        name: str,
        warn: Callable[[str], None],
        *,
        most_waiting: int = MAX_WAITING,
    ) -> None:
        """Begin.

        Args:
            file: where to write, not buffered.
            name: of the file, for people.
            warn: takes a sentence, and waits for nobody.
            most_waiting: bytes that may wait.
        """
        self._file = file
        self._name = printable(name)
        self._warn = warn
        self._most_waiting = most_waiting
        self._buffer = _BlockBuffer()
        self._recording = SocketRecording(self._buffer)
        self._steps: deque[tuple[int, _WriteStep]] = deque()
        self._batch: list[bytes] = []
        self._queued_size = self._written_size = 0
        self._skipped = self._lost = 0
        self._recorded_directions: set[_Direction] = set()
        self._gap_bytes: dict[_Direction, int] = {}
        self._delayed_steps: list[_WriteStep] = []
        self._failed = False
        self._has_work, self._is_closing = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._write_blocks, name="recorder", daemon=True)
        self._thread.start()
        self._has_work.set()

    def on_datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Record a UDP datagram."""
        if self._has_room(len(data)):
            comment = self._end_gap()
            self._queue_step(
                len(data),
                lambda recording: recording.write_datagram(source, target, data, time, comment=comment),
            )

    def on_segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Record bytes of a TCP connection."""
        way = (source, target)
        if self._has_room(len(data)):
            comment = self._end_gap()
            self._recorded_directions.add(way)
            self._queue_step(
                len(data),
                lambda recording: recording.write_segment(source, target, data, time, comment=comment),
            )
        elif way in self._recorded_directions:
            self._gap_bytes[way] = self._gap_bytes.get(way, 0) + len(data)

    def on_stream_end(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        """Record that an end of a TCP connection, of which there is anything, has ended it."""
        if not self._recorded_directions.isdisjoint(((source, target), (target, source))) and self._has_room(
            0
        ):
            comment = self._end_gap()
            self._queue_step(
                0,
                lambda recording: recording.write_stream_end(
                    source, target, time, reset=reset, comment=comment
                ),
            )

    def on_connection_end(self, client: Address, server: Address) -> None:
        """Forget a TCP connection."""
        ways = {(client, server), (server, client)} & self._recorded_directions
        if not ways or self._failed:
            return
        self._recorded_directions -= ways
        for way in ways:
            self._gap_bytes.pop(way, None)

        def forget(recording: SocketRecording) -> None:
            recording.drop_connection(client, server)

        if self._skipped:
            self._delayed_steps.append(forget)
        else:
            self._queue_step(0, forget)

    def on_idle(self) -> bool:
        """Make packets of what was taken, and let the thread write them; called when all are answered.

        Returns:
            Whether there is more of it, and it should be called again soon.
        """
        return self._make_packets(_MAKE_FOR_NS)

    def _make_packets(self, most: int) -> bool:
        """Make packets for so many ns; return whether there is more to do."""
        steps = self._steps
        if not steps:
            return False
        until = time.monotonic_ns() + most
        while steps and time.monotonic_ns() < until:
            size, step = steps.popleft()
            self._queued_size -= size
            step(self._recording)
        if not self._has_work.is_set():
            self._has_work.set()
        return bool(steps)

    def close(self) -> bool:
        """Write what is left, if the disk takes it soon; tell whether nothing is missing."""
        self._make_packets(round(_ENDS_WITHIN * 1e9))
        self._is_closing.set()
        self._has_work.set()
        self._thread.join(_ENDS_WITHIN)
        if not self._thread.is_alive():
            self._file.close()
        elif not self._failed:
            self._lost += sum(map(is_packet_block, (*self._batch, *self._buffer.blocks)))
        self._lost += len(self._steps)
        self._lost += self._skipped
        if self._lost:
            self._warn(f"{self._name} lacks {counted(self._lost, 'packet')}: it was not written fast enough")
        return not self._lost and not self._failed

    def _has_room(self, size: int) -> bool:
        if self._failed:
            return False
        waiting = self._queued_size + self._buffer.size - self._written_size
        # Once packets are missing, half of the room must be free: rather one long gap than many short ones.
        if waiting + size + _PACKET_OVERHEAD <= (
            self._most_waiting // 2 if self._skipped else self._most_waiting
        ):
            return True
        if not self._skipped and not self._lost:
            self._warn(f"{self._name} is not written fast enough: packets are missing in it from now on")
        self._skipped += 1
        return False

    def _end_gap(self) -> str:
        """Go on behind packets that are missing; return what is to be noted with the next one."""
        if not self._skipped:
            return ""
        missing, self._skipped = self._skipped, 0
        self._lost += missing
        steps = self._delayed_steps, self._gap_bytes
        self._delayed_steps, self._gap_bytes = [], {}
        self._queue_step(0, lambda recording: _write_gap(recording, *steps))
        return f"{counted(missing, 'packet')} before this one could not be written in time"

    def _queue_step(self, size: int, step: _WriteStep) -> None:
        self._steps.append((size + _PACKET_OVERHEAD, step))
        self._queued_size += size + _PACKET_OVERHEAD

    def _write_blocks(self) -> None:
        blocks, size = self._buffer.blocks, 0
        try:
            while not self._is_closing.is_set() or blocks:
                self._has_work.wait()
                self._has_work.clear()
                self._batch = [blocks.popleft() for _ in range(len(blocks))]
                data = b"".join(self._batch)
                write_all(self._file, data)
                size += len(data)
                self._written_size += len(data) + len(self._batch) * _PACKET_OVERHEAD
                self._batch = []
                self._is_closing.wait(_WRITE_INTERVAL)
        except OSError as error:
            self._failed = True
            with suppress(OSError):
                self._file.truncate(size)  # so that it ends with a whole packet
            self._warn(f"{self._name} is not written any more: {(error.strerror or str(error)).lower()}")
            blocks.clear()


def _write_gap(recording: SocketRecording, late: list[_WriteStep], gaps: dict[_Direction, int]) -> None:
    for step in late:
        step(recording)
    for way, size in gaps.items():
        recording.skip_bytes(*way, size)
