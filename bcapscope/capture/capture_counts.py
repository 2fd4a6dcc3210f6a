"""What became of the packets of a capture."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class CaptureCounts:
    """Sums over a capture so far; a packet is counted at most once among those without an observation.

    Attributes:
        packets: read.
        items: observations made of them: frames, bytes that are none, and holes.
        malformed: observations that are bytes and no frame.
        gaps: observations that are holes in a TCP stream.
        missing: bytes in those holes.
        not_ip: packets that carry something else, such as ARP.
        broken: packets whose headers are damaged or cut off, so that nothing can be told of them.
        not_bcap: IP packets with something else in them; TCP segments without content are not among them.
        cut: packets of which the capture kept only the beginning.
        fragments_lost: fragmented IP packets of which a part was not seen.
        contradictions: TCP segments sent again with other content than before.
        unknown_links: packets by link type that is not known here.
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
        """Observations that are frames, sound or not."""
        return self.items - self.malformed - self.gaps
