"""A capture of a server's traffic, written by a thread of its own so that no client waits for a disk.

The server's thread encodes packets after it has answered the client. Encoding in a second thread would take
the interpreter from the first and cost milliseconds. The recorder's thread only waits for the disk.
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
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.text_format import counted
from bcapscope.render.escape import printable

MAX_WAITING = 16 << 20
"""Bytes that may wait for the disk, overhead included. Beyond that, packets are left out and counted."""

_PACKET_OVERHEAD = 512
"""Bytes of memory that a packet needs besides its data."""

_WRITE_INTERVAL = 0.02
"""Seconds between writes to the disk."""

_MAKE_FOR_NS = 1_000_000
"""ns for encoding packets before the server checks for new requests."""

_ENDS_WITHIN = 5.0
"""Seconds for writing the rest at the end."""

_WriteStep: TypeAlias = Callable[[SocketRecording], None]
_Direction: TypeAlias = tuple[Address, Address]


def create_capture(path: Path) -> BinaryIO | RawIOBase:
    """Create a capture file. It is unbuffered, so that a kill loses nothing that was written.

    Raises:
        FileWriteError: The file exists already, or cannot be created.
    """
    try:
        return path.open("xb", buffering=0)
    except OSError as error:
        raise FileWriteError(path, os_reason(error)) from None


class _BlockBuffer(RawIOBase):
    """Encoded packets that wait for the writing thread.

    Attributes:
        blocks: Blocks in the order of writing.
        size: Total of all bytes ever written, plus `_PACKET_OVERHEAD` for each write.
    """

    def __init__(self) -> None:
        self.blocks: deque[bytes] = deque()
        self.size = 0

    def write(self, data: Any) -> int:
        """Append one block."""
        self.blocks.append(bytes(data))
        self.size += len(data) + _PACKET_OVERHEAD
        return len(data)


class ServerRecorder:
    """Writes a capture without delaying the server. It counts and reports packets that it cannot write in
    time.

    All methods except the writing thread's run in the server's thread.
    """

    def __init__(
        self,
        file: BinaryIO | RawIOBase,
        name: str,
        warn: Callable[[str], None],
        *,
        most_waiting: int = MAX_WAITING,
    ) -> None:
        """Start the writing thread.

        Args:
            file: Unbuffered file to write to.
            name: Name of the file, for messages.
            warn: Called with a message. It must not block.
            most_waiting: Bytes that may wait for the disk.
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
        """Record that one end has closed a TCP connection, if any of its bytes are recorded."""
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
        """Encode waiting packets and wake the writing thread. Call this once all requests are answered.

        Returns:
            True if packets remain and the method should be called again soon.
        """
        return self._make_packets(_MAKE_FOR_NS)

    def _make_packets(self, most: int) -> bool:
        """Encode packets for at most `most` ns. Return whether packets remain."""
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
        """Write the rest for at most `_ENDS_WITHIN` seconds. Return whether the capture is complete."""
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
        # After a loss, half of the room must be free again: one long gap is better than many short ones.
        if waiting + size + _PACKET_OVERHEAD <= (
            self._most_waiting // 2 if self._skipped else self._most_waiting
        ):
            return True
        if not self._skipped and not self._lost:
            self._warn(f"{self._name} is not written fast enough: packets are missing in it from now on")
        self._skipped += 1
        return False

    def _end_gap(self) -> str:
        """Resume after missing packets. Return the comment for the next packet, "" if none is missing."""
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
            self._warn(f"{self._name} is not written any more: {os_reason(error)}")
            blocks.clear()


def _write_gap(recording: SocketRecording, late: list[_WriteStep], gaps: dict[_Direction, int]) -> None:
    for step in late:
        step(recording)
    for way, size in gaps.items():
        recording.skip_bytes(*way, size)
