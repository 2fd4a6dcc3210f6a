"""Where frames are found: in which captures, and in which packets."""

from __future__ import annotations

from bcapscope.capture.capture_sequence import PacketOrigin, PacketOrigins, RunTable
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.pipeline import PipelineSubscriber


class FrameOrigins(PipelineSubscriber):
    """Remembers which packet of which capture completed each frame."""

    def __init__(self, packets: PacketOrigins) -> None:
        self._packets = packets
        self._runs = RunTable()
        self._distance: int | None = None

    def on_frame(self, observation: Observation) -> None:
        number, packet = observation.number, observation.packet
        if packet - number != self._distance:
            self._distance = packet - number
            self._runs.add(number, 0, packet)

    def origin_of(self, frame: int) -> PacketOrigin | None:
        """Return where a frame is found, by its number; None if it is not known."""
        found = self._runs.find(frame)
        return None if found is None else self._packets.origin_of(found[1])
