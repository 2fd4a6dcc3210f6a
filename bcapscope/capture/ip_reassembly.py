"""Reassembly of fragmented IP packets."""

from __future__ import annotations

from itertools import accumulate

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.link_layer import IPPacket

REASSEMBLY_TIMEOUT = 30 * 1_000_000_000
"""Time in ns from the first fragment until an incomplete packet is dropped, as in Linux (ipfrag_time)."""

MEMORY_LIMIT = 4 * 1024 * 1024
"""Maximum number of bytes held for incomplete packets, as in Linux (ipfrag_high_thresh)."""

LARGEST_PAYLOAD = 65535
"""Longest payload of a fragmented IP packet, in bytes (RFC 791; RFC 8200 for IPv6)."""

_PART_COST = 128  # bytes of memory that a fragment takes in addition to its content


class _PartialPacket:
    def __init__(self, began: int) -> None:
        self.began = began
        self.protocol: int | None = None
        self._payloads: dict[int, bytes] = {}
        self._held_bytes = 0
        self._size: int | None = None
        self._is_contradictory = False

    @property
    def cost(self) -> int:
        """Approximate memory use in bytes."""
        return self._held_bytes + _PART_COST * (len(self._payloads) + 1)

    def add(self, offset: int, payload: bytes, more: bool) -> None:
        """Add a fragment. Contradictory fragments make the packet invalid (RFC 5722, RFC 8200 4.5)."""
        if self._is_contradictory:
            return
        stop = offset + len(payload)
        known = self._payloads.get(offset)
        is_new_end = not more and self._size != stop
        if known not in (None, payload) or (is_new_end and (self._size, known) != (None, None)):
            self._mark_contradictory()
            return
        if not more:
            self._size = stop
        if payload and known is None:
            self._payloads[offset] = payload
            self._held_bytes += len(payload)
        limit = LARGEST_PAYLOAD if self._size is None else self._size
        if stop > LARGEST_PAYLOAD or self._held_bytes > limit:
            self._mark_contradictory()

    def joined_payload(self) -> bytes | None:
        if self._held_bytes != self._size:
            return None
        offsets = sorted(self._payloads)
        payloads = [self._payloads[offset] for offset in offsets]
        ends = accumulate(map(len, payloads), initial=0)
        return b"".join(payloads) if offsets == list(ends)[:-1] else None

    def _mark_contradictory(self) -> None:
        self._payloads.clear()
        self._held_bytes, self._size, self._is_contradictory = 0, None, True


class IpReassembly:
    """Reassembles IP packets. `counts.fragments_lost` counts the incomplete packets that this class drops."""

    def __init__(self, counts: CaptureCounts) -> None:
        self._counts = counts
        self._incomplete: dict[bytes, _PartialPacket] = {}
        self._cost = 0

    def add(self, packet: IPPacket, time: int) -> tuple[IPPacket, int] | None:
        """Accept a whole IP packet or a fragment. Return the whole packet, and the time in ns at which its
        first fragment arrived; None while fragments are missing.
        """
        fragment = packet.fragment
        if fragment is None:
            return packet, time
        self._drop_expired(time)
        parts = self._incomplete.get(fragment.key)
        if parts is None:
            parts = self._incomplete[fragment.key] = _PartialPacket(time)
        else:
            self._cost -= parts.cost
        if packet.missing == 0:
            parts.add(fragment.offset, packet.payload, fragment.more)
        if fragment.offset == 0:
            parts.protocol = packet.protocol
        self._cost += parts.cost
        payload = parts.joined_payload()
        if payload is None or parts.protocol is None:
            return None
        self._remove(fragment.key)
        return IPPacket(parts.protocol, packet.addresses, payload, 0, None), parts.began

    def close(self) -> None:
        self._counts.fragments_lost += len(self._incomplete)
        self._incomplete.clear()
        self._cost = 0

    def _remove(self, key: bytes) -> None:
        self._cost -= self._incomplete.pop(key).cost

    def _drop_expired(self, time: int) -> None:
        """Drop incomplete packets that are too old, and the oldest if memory exceeds `MEMORY_LIMIT`."""
        while self._incomplete:
            key, oldest = next(iter(self._incomplete.items()))
            if oldest.began + REASSEMBLY_TIMEOUT > time and self._cost <= MEMORY_LIMIT:
                return
            self._counts.fragments_lost += 1
            self._remove(key)
