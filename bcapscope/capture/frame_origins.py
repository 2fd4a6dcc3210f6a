"""Find the capture and the packet that hold a frame."""

from __future__ import annotations

from bcapscope.capture.capture_sequence import PacketOrigin, PacketOrigins
from bcapscope.capture.run_table import RunTable


class FrameOrigins:
    """Finds the packet that completed a frame. A decoder adds the packets."""

    def __init__(self, packets: PacketOrigins) -> None:
        self._packets_of_frames = RunTable()
        self._packets = packets

    def add(self, frame: int, packet: int) -> None:
        """Remember in which packet a frame is. Until the next call of this method, each later frame is in the
        packet after the previous frame's packet.
        """
        self._packets_of_frames.add(frame, 0, packet)

    def origin_of(self, frame: int) -> PacketOrigin | None:
        """Return the capture and the packet that hold the frame with this number; None if not known."""
        found = self._packets_of_frames.find(frame)
        return None if found is None else self._packets.origin_of(found[1])
