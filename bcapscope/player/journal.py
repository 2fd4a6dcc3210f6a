"""What was said: the last frames for those who watch, and all of it for a capture.

Frames are kept in memory while set points are sent, and written when that is over: a disk may take longer
than a set point has.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from operator import itemgetter
from typing import BinaryIO

from bcapscope.capture.recording import Recording
from bcapscope.player.channel import Channel
from bcapscope.player.messages import Packet

MOST_KEPT = 2_000_000
"""Frames that are kept, those of more than two hours at 8 ms; what comes later is not recorded."""


class Journal:
    """Hears of every frame.

    Attributes:
        sent: the last frame that went out.
        received: the last that came in.
        pacing: set points are being sent, so that frames are only kept.
    """

    def __init__(self, tell: Callable[[Packet], object], record: BinaryIO | None) -> None:
        """Tell of each frame outside of pacing; `record` is a file for a capture."""
        self.sent = b""
        self.received = b""
        self.pacing = False
        self._tell = tell
        self._epoch = time.time_ns() - time.monotonic_ns()
        self._file = record
        self._kept: list[tuple[bool, bytes, int]] = []

    def hear(self, sent: bool, raw: bytes, now: int) -> None:
        """Take a frame; `now` is ns of the monotonic clock, when it was sent or when it came."""
        if sent:
            self.sent = raw
        else:
            self.received = raw
        if self._file is not None and len(self._kept) < MOST_KEPT:
            self._kept.append((sent, raw, now))
        if not self.pacing:
            self._tell(Packet(sent, raw, now + self._epoch))

    def save(self, link: Channel) -> None:
        """Write the capture.

        Raises:
            OSError: there is no room, or the like.
        """
        if self._file is None:
            return
        recording = Recording(self._file)
        write = recording.datagram if link.datagrams else recording.segment
        self._kept.sort(key=itemgetter(2))  # a reply may be read long after it came
        for sent, raw, now in self._kept:
            ends = (link.local, link.peer) if sent else (link.peer, link.local)
            write(*ends, raw, now + self._epoch)
        self._file.flush()
        self._kept.clear()
