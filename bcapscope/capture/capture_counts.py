"""Counts of packets and observations in a capture."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class CaptureCounts:
    """Numbers of packets and observations of a capture, as read so far.

    A packet without observation is counted in `packets`, possibly in `cut`, and at most in one other field.

    Attributes:
        items: Number of observations: frames, bytes that are not a frame, and gaps.
        malformed: Number of observations of bytes that are not a frame.
        missing: Number of bytes missing in the gaps of TCP streams.
        not_ip: Number of packets of protocols other than IP, such as ARP.
        broken: Number of packets whose headers are damaged or cut off.
        not_bcap: Number of IP packets without b-CAP, except empty TCP segments.
        cut: Number of packets that lack their end in the capture.
        fragments_lost: Number of IP packets dropped because fragments were missing or contradictory.
        contradictions: Number of TCP retransmissions whose content differs from the first transmission.
        unknown_links: For each unknown link type, the number of packets.
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
