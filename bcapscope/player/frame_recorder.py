"""The frames of a player: the last ones for display, and all of them for a recording.

While set points are sent, the recorder keeps frames in memory and writes them afterwards: a disk may take
longer than the time between two set points.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from operator import itemgetter
from typing import BinaryIO

from bcapscope.capture.socket_recording import SocketRecording
from bcapscope.player.channel import Channel
from bcapscope.player.player_messages import FrameMessage

MAX_FRAMES = 2_000_000
"""Frames kept, more than two hours at 8 ms; later frames are not recorded."""


class FrameRecorder:
    """Receives every frame.

    Attributes:
        last_sent: The last frame sent.
        last_received: The last frame received.
        is_pacing: Whether set points are being sent; then frames are only kept.
    """

    def __init__(self, send: Callable[[FrameMessage], object], record: BinaryIO | None) -> None:
        """Report each frame outside of pacing to `send`; `record` is a file for the recording, or None."""
        self.last_sent = b""
        self.last_received = b""
        self.is_pacing = False
        self._send = send
        self._epoch_offset = time.time_ns() - time.monotonic_ns()
        self._file = record
        self._frames: list[tuple[bool, bytes, int]] = []

    def on_frame(self, sent: bool, raw: bytes, now: int) -> None:
        """Note a frame; `now` is when it was sent or received, ns of the monotonic clock."""
        if sent:
            self.last_sent = raw
        else:
            self.last_received = raw
        if self._file is not None and len(self._frames) < MAX_FRAMES:
            self._frames.append((sent, raw, now))
        if not self.is_pacing:
            self._send(FrameMessage(sent, raw, now + self._epoch_offset))

    def save_capture(self, link: Channel) -> None:
        """Write the recording, if there is a file for it.

        Raises:
            OSError: The file cannot be written, for example because the disk is full.
        """
        if self._file is None:
            return
        recording = SocketRecording(self._file)
        write = recording.write_datagram if link.datagrams else recording.write_segment
        self._frames.sort(key=itemgetter(2))  # a reply may be read long after it arrived
        for sent, raw, now in self._frames:
            ends = (link.local, link.peer) if sent else (link.peer, link.local)
            write(*ends, raw, now + self._epoch_offset)
        self._file.flush()
        self._frames.clear()
