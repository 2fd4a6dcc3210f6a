"""Records the traffic of a simulator, of `replay` or of the Tester in the same process. A separate thread
writes to the disk.

In a simulator and in `replay`, the thread that answers requests also encodes packets, while no request waits.
The Tester encodes each packet as soon as the packet is sent or received. A second thread for encoding would
hold Python's interpreter lock, and would delay replies by milliseconds.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from operator import methodcaller
from typing import TypeAlias

from bcapscope.capture.socket_recording import Address, SocketRecording
from bcapscope.live.recorder import Recorder
from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.protocol.text_format import counted
from bcapscope.traffic.observation import Observation, Transport

MAX_WAITING = 16 << 20
"""Maximum number of bytes that may wait to be written; each packet counts as `_STEP_OVERHEAD` bytes more than
its data. At this limit, the recorder leaves out new packets and counts them.
"""

_STEP_OVERHEAD = 512
"""Memory in bytes that a packet needs until it is encoded, in addition to the memory for its data."""

_WRITE_INTERVAL = 0.02
"""Time in s between two writes to the disk."""

_CHECK_INTERVAL = 0.002
"""`wait_until_written` checks at this interval, in s, whether the packets are in the file."""

_MAKE_FOR_NS = 1_000_000
"""Maximum time in ns for encoding packets before the simulator or `replay` checks for new requests."""

_ENDS_WITHIN = 5.0
"""Maximum time in s that `close` spends on encoding, and again on writing."""

_WriteStep: TypeAlias = Callable[[SocketRecording], None]


class BackgroundRecorder:
    """Records packets without delaying the caller, and counts packets that could not be written in time.

    Call all methods except `on_observation` and `wait_until_written` from the same thread.
    """

    def __init__(self, recorder: Recorder) -> None:
        """Start the writing thread. The recorder must not record to a ring of files."""
        self._recorder = recorder
        self._steps: deque[tuple[int, _WriteStep]] = deque()
        self._queued_size = 0
        self._skipped = self._lost = 0
        # for each direction of a recorded TCP connection, the number of bytes missing since the last packet
        self._gap_bytes: dict[tuple[Address, Address], int] = {}
        self._lock = threading.Lock()
        self._has_work, self._is_closing = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._write_to_disk, name="recorder", daemon=True)
        self._thread.start()

    def on_observation(self, observation: Observation) -> None:
        """Record a frame that this program's client sent or received. Any thread may call this."""
        flow = observation.flow
        add = self.on_segment if flow.conversation.transport is Transport.TCP else self.on_datagram
        with self._lock:
            add(flow.src, flow.dst, observation.item.raw, observation.time)
            self.on_idle()

    def on_datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        self._queue_packet(len(data), SocketRecording.write_datagram, source, target, data, time)

    def on_segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        direction = (source, target)
        if self._queue_packet(len(data), SocketRecording.write_segment, source, target, data, time):
            self._gap_bytes.setdefault(direction, 0)
        elif direction in self._gap_bytes:
            self._gap_bytes[direction] += len(data)

    def on_stream_end(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        """Record that one end closed a TCP connection, if the recording holds data of this connection."""
        if (source, target) in self._gap_bytes or (target, source) in self._gap_bytes:
            write = partial(SocketRecording.write_stream_end, reset=reset)
            self._queue_packet(0, write, source, target, time)

    def on_connection_end(self, client: Address, server: Address) -> None:
        up = self._gap_bytes.pop((client, server), None)
        down = self._gap_bytes.pop((server, client), None)
        if up is not None or down is not None:
            self._queue_step(0, lambda recording: recording.drop_connection(client, server))

    def on_idle(self) -> bool:
        """Encode waiting packets for at most `_MAKE_FOR_NS`. Return whether packets still wait."""
        return self._make_packets(_MAKE_FOR_NS)

    def _make_packets(self, most: int) -> bool:
        steps = self._steps
        if not steps:
            return False
        until = time.monotonic_ns() + most
        while steps and time.monotonic_ns() < until:
            size, step = steps.popleft()
            self._queued_size -= size
            step(self._recorder.packets)
        if not self._has_work.is_set():
            self._has_work.set()
        return bool(steps)

    def wait_until_written(self, seconds: float) -> None:
        """Wait until the encoded packets are in the file, but at most `seconds`. Any thread may call this."""
        until = time.monotonic() + seconds
        while (
            self._recorder.is_complete
            and self._recorder.files.bytes_pending
            and time.monotonic() < until
            and not self._is_closing.is_set()
        ):
            self._has_work.set()
            time.sleep(_CHECK_INTERVAL)

    def close(self) -> bool:
        """Encode the waiting packets, then write them; each step takes at most `_ENDS_WITHIN`. Return whether
        no packet was lost.
        """
        self._make_packets(round(_ENDS_WITHIN * 1e9))
        self._is_closing.set()
        self._has_work.set()
        self._thread.join(_ENDS_WITHIN)
        if not self._thread.is_alive():
            self._recorder.close()
        elif self._recorder.is_complete:
            self._lost += self._recorder.files.packets_pending
        self._lost += len(self._steps) + self._skipped
        if self._lost:
            lost = Count(self._lost, "packet")
            self._recorder.warn(Message("recording.lacks", name=self._recorder.name, lost=lost))
        return not self._lost and self._recorder.is_complete

    def _queue_packet(self, size: int, write: Callable[..., None], *arguments: object) -> bool:
        """If there is no room for a packet with `size` bytes of data, count it as missing; return False."""
        if not self._recorder.is_complete:
            return False
        waiting = self._queued_size + self._recorder.files.bytes_pending
        # After packets were left out, recording resumes only when half of the memory for waiting packets is
        # free. One long gap in a recording is better than many short gaps.
        if waiting + size + _STEP_OVERHEAD > (MAX_WAITING // 2 if self._skipped else MAX_WAITING):
            if not self._skipped and not self._lost:
                self._recorder.warn(Message("recording.slow", name=self._recorder.name))
            self._skipped += 1
            return False
        comment = self._end_gap()
        self._queue_step(size, lambda recording: write(recording, *arguments, comment=comment))
        return True

    def _end_gap(self) -> str:
        """Resume after missing packets. Return a comment with the number of missing packets, or ""."""
        if not self._skipped:
            return ""
        missing, self._skipped = self._skipped, 0
        self._lost += missing
        for direction, size in self._gap_bytes.items():
            if size:
                self._queue_step(0, methodcaller("skip_bytes", *direction, size))
                self._gap_bytes[direction] = 0
        return f"missing before this packet: {counted(missing, 'packet')}, not written in time"

    def _queue_step(self, size: int, step: _WriteStep) -> None:
        self._steps.append((size + _STEP_OVERHEAD, step))
        self._queued_size += size + _STEP_OVERHEAD

    def _write_to_disk(self) -> None:
        while not self._is_closing.wait(_WRITE_INTERVAL):
            self._has_work.wait()
            self._has_work.clear()
            self._recorder.flush()
        self._recorder.flush()
