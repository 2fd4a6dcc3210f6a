"""What was said: the last frames for those who watch, and all of it for a capture.

Frames are kept in memory while set points are sent, and written when that is over: a disk may take longer
than a set point has.
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
"""Frames that are kept, those of more than two hours at 8 ms; what comes later is not recorded."""


class FrameRecorder:
    """Hears of every frame.

    Attributes:
        last_sent: the last frame that went out.
        last_received: the last that came in.
        is_pacing: set points are being sent, so that frames are only kept.
    """

    def __init__(self, send: Callable[[FrameMessage], object], record: BinaryIO | None) -> None:
        """Tell of each frame outside of pacing; `record` is a file for a capture."""
        self.last_sent = b""
        self.last_received = b""
        self.is_pacing = False
        self._send = send
        self._epoch_offset = time.time_ns() - time.monotonic_ns()
        self._file = record
        self._frames: list[tuple[bool, bytes, int]] = []

    def on_frame(self, sent: bool, raw: bytes, now: int) -> None:
        """Take a frame; `now` is ns of the monotonic clock, when it was sent or when it came."""
        if sent:
            self.last_sent = raw
        else:
            self.last_received = raw
        if self._file is not None and len(self._frames) < MAX_FRAMES:
            self._frames.append((sent, raw, now))
        if not self.is_pacing:
            self._send(FrameMessage(sent, raw, now + self._epoch_offset))

    def save_capture(self, link: Channel) -> None:
        """Write the capture.

        Raises:
            OSError: there is no room, or the like.
        """
        if self._file is None:
            return
        recording = SocketRecording(self._file)
        write = recording.write_datagram if link.datagrams else recording.write_segment
        self._frames.sort(key=itemgetter(2))  # a reply may be read long after it came
        for sent, raw, now in self._frames:
            ends = (link.local, link.peer) if sent else (link.peer, link.local)
            write(*ends, raw, now + self._epoch_offset)
        self._file.flush()
        self._frames.clear()
