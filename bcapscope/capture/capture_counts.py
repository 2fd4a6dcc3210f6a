"""Counts of packets and observations in a capture."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class CaptureCounts:
    """Sums over a capture so far. A packet without an observation is counted for one reason at most.

    Attributes:
        packets: Packets read.
        items: Observations: frames, bytes that are no frame, and gaps.
        malformed: Observations of bytes that are no frame.
        gaps: Observations of gaps in a TCP stream.
        missing: Bytes in those gaps.
        not_ip: Packets of other protocols than IP, such as ARP.
        broken: Packets whose headers are damaged or cut off, so that they cannot be decoded.
        not_bcap: IP packets with other content than b-CAP, except TCP segments without content.
        cut: Packets of which the capture kept only the beginning.
        fragments_lost: Fragmented IP packets dropped because fragments were missing or contradictory.
        contradictions: TCP retransmissions whose content differs from the first transmission.
        unknown_links: Packets with an unknown link type, by that type.
    """

    packets: int = 0
    items: int = 0
    malformed: int = 0
    gaps: int = 0
    missing: int = 0
    not_ip: int = 0
    broken: int = 0
    not_bcap: int = 0
    cut: int = 0
    fragments_lost: int = 0
    contradictions: int = 0
    unknown_links: Counter[int] = field(default_factory=Counter)

    @property
    def frames(self) -> int:
        return self.items - self.malformed - self.gaps
