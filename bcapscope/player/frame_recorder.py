"""Collects the frames of a player, to display the last frames and to record all frames.

The frames stay in memory until the end, because a disk access may take longer than the time between two set
points. A second thread for writing would not help: Python runs only one thread at a time, so the second
thread would delay the thread that sends set points.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from operator import itemgetter
from pathlib import Path

from bcapscope.capture.rotating_recording import RotatingRecording
from bcapscope.player.blocking_caller import Channel
from bcapscope.player.player_messages import FrameMessage

MAX_FRAMES = 2_000_000
"""Maximum number of frames, enough for two hours at a cycle time of 8 ms. Later frames are dropped."""

_FRAMES_PER_WRITE = 1000
"""Number of frames per write. If the disk becomes full, the frames of the last write are lost."""


@contextmanager
def open_recording(path: str | None) -> Iterator[RotatingRecording | None]:
    """Create a recording. At the end, delete the recording if it is empty. Without a path, yield None."""
    if path is None:
        yield None
        return
    with closing(RotatingRecording(Path(path))) as recording:
        try:
            yield recording
        finally:
            if recording.is_empty:
                Path(path).unlink(missing_ok=True)


class FrameRecorder:
    """Keeps every frame for the recording. While `is_pacing` is False, also sends each frame for display."""

    def __init__(self, send: Callable[[FrameMessage], object], recording: RotatingRecording | None) -> None:
        self.last_sent = b""
        self.last_received = b""
        self.is_pacing = False
        self._send = send
        self._epoch_offset = time.time_ns() - time.monotonic_ns()
        self._recording = recording
        self._frames: list[tuple[bool, bytes, int]] = []

    def on_frame(self, sent: bool, raw: bytes, now: int) -> None:
        """Keep a frame that was sent or received at `now`, in ns of the monotonic clock."""
        if sent:
            self.last_sent = raw
        else:
            self.last_received = raw
        if self._recording is not None and len(self._frames) < MAX_FRAMES:
            self._frames.append((sent, raw, now))
        if not self.is_pacing:
            self._send(FrameMessage(sent, raw, now + self._epoch_offset))

    def save_capture(self, link: Channel) -> None:
        if self._recording is None:
            return
        packets = self._recording.recording
        write = packets.write_datagram if link.datagrams else packets.write_segment
        # sort by time: the player may read a reply long after its arrival
        self._frames.sort(key=itemgetter(2))
        for number, (sent, raw, now) in enumerate(self._frames, 1):
            ends = (link.local, link.peer) if sent else (link.peer, link.local)
            write(*ends, raw, now + self._epoch_offset)
            if not number % _FRAMES_PER_WRITE:
                self._recording.flush()
        self._recording.flush()
        self._frames.clear()
