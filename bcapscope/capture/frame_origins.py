"""Where frames are found: in which captures, and in which packets."""

from __future__ import annotations

from bcapscope.capture.capture_sequence import PacketOrigin, PacketOrigins
from bcapscope.capture.run_table import RunTable


class FrameOrigins:
    """Finds the packet that completed a frame. A decoder adds the packets."""

    def __init__(self, packets: PacketOrigins) -> None:
        self._packets_of_frames = RunTable()
        self._packets = packets

    def add(self, frame: int, packet: int) -> None:
        """Add the packet number of a frame. Both numbers count up together until the next call."""
        self._packets_of_frames.add(frame, 0, packet)

    def origin_of(self, frame: int) -> PacketOrigin | None:
        """Return where a frame is found, by its number; None if it is not known."""
        found = self._packets_of_frames.find(frame)
        return None if found is None else self._packets.origin_of(found[1])
