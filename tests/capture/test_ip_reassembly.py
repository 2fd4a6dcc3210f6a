"""Fragmented packets: parts in any order, sent twice, lost, or contradicting each other."""

from __future__ import annotations

from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.ip_reassembly import (
    LARGEST_PAYLOAD,
    MEMORY_LIMIT,
    REASSEMBLY_TIMEOUT,
    IpReassembly,
)
from bcapscope.capture.link_layer import Fragment, IPPacket

ADDRESSES = bytes(range(8))


def part(offset: int, payload: bytes, more: bool, key: bytes = b"key", missing: int = 0) -> IPPacket:
    return IPPacket(17, ADDRESSES, payload, missing, Fragment(key, offset, more))


def whole(payload: bytes, began: int) -> tuple[IPPacket, int]:
    return IPPacket(17, ADDRESSES, payload, 0, None), began


def test_what_is_whole_is_left_alone() -> None:
    packet = IPPacket(6, ADDRESSES, b"whole", 0, None)
    assert IpReassembly(CaptureCounts()).add(packet, 5) == (packet, 5)


@given(data=st.data(), content=st.binary(min_size=1, max_size=300))
def test_any_order_with_any_part_twice_gives_the_packet_once(data: st.DataObject, content: bytes) -> None:
    cuts = sorted(data.draw(st.sets(st.integers(0, (len(content) - 1) // 8)))) or [0]
    starts = [8 * cut for cut in {0, *cuts}]
    starts.sort()
    parts = [
        part(start, content[start:stop], stop < len(content))
        for start, stop in zip(starts, [*starts[1:], len(content)], strict=True)
    ]
    shuffled = data.draw(st.permutations(parts))
    again = data.draw(st.lists(st.sampled_from(shuffled[:-1]), max_size=3)) if len(parts) > 1 else []
    fragments = IpReassembly(counts := CaptureCounts())
    for time, each in enumerate([*shuffled[:-1], *again]):
        assert fragments.add(each, time) is None
    assert fragments.add(shuffled[-1], 99) == whole(content, 0 if len(parts) > 1 else 99)
    fragments.close()
    assert counts.fragments_lost == 0


def test_packets_are_told_apart() -> None:
    fragments = IpReassembly(CaptureCounts())
    assert fragments.add(part(0, b"a" * 8, True, b"one"), 1) is None
    assert fragments.add(part(0, b"b" * 8, True, b"two"), 2) is None
    assert fragments.add(part(8, b"B", False, b"two"), 3) == whole(b"bbbbbbbbB", 2)
    assert fragments.add(part(8, b"A", False, b"one"), 4) == whole(b"aaaaaaaaA", 1)


def test_the_protocol_is_that_of_the_first_part() -> None:
    fragments = IpReassembly(CaptureCounts())
    fragments.add(part(8, b"x", False)._replace(protocol=0), 1)
    found = fragments.add(part(0, bytes(8), True), 2)
    assert found is not None
    assert found[0].protocol == 17


def test_parts_that_contradict_each_other_spoil_the_packet() -> None:
    for other in (
        part(8, b"other678", True),  # the same place, other content
        part(0, b"longer and over the next", True),
        part(12, b"inside", True),
        part(4, b"before", True),
        part(40, b"", False),  # another end
    ):
        fragments = IpReassembly(counts := CaptureCounts())
        assert fragments.add(part(8, b"second 8", True), 1) is None
        assert fragments.add(part(16, b"end", False), 1) is None
        assert fragments.add(other, 2) is None
        assert fragments.add(part(0, b"first 8 ", True), 3) is None
        fragments.close()
        assert counts.fragments_lost == 1


def test_a_part_that_others_follow_cannot_become_the_last_one() -> None:
    fragments = IpReassembly(counts := CaptureCounts())
    assert fragments.add(part(0, b"first 8 ", True), 1) is None
    assert fragments.add(part(0, b"first 8 ", False), 2) is None
    fragments.close()
    assert counts.fragments_lost == 1


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_a_part_behind_the_end_does_not_stand_in_for_a_missing_one(order: tuple[int, ...]) -> None:
    """As many bytes as the packet has, and yet not all of it."""
    parts = part(0, b"first 8 ", True), part(16, b"the end.", False), part(40, b"beyond 8", True)
    fragments = IpReassembly(counts := CaptureCounts())
    for time, each in enumerate(order):
        assert fragments.add(parts[each], time) is None
    fragments.close()
    assert counts.fragments_lost == 1


def test_a_part_that_the_capture_cut_never_completes_a_packet() -> None:
    fragments = IpReassembly(CaptureCounts())
    fragments.add(part(0, b"half", True, missing=4), 1)
    assert fragments.add(part(8, b"end", False), 2) is None
    assert fragments.add(part(0, b"whole 8 ", True), 3) == whole(b"whole 8 end", 1)


def test_no_packet_is_longer_than_any_can_be() -> None:
    fragments = IpReassembly(counts := CaptureCounts())
    assert fragments.add(part(LARGEST_PAYLOAD - 3, b"1234", False), 1) is None
    fragments.close()
    assert counts.fragments_lost == 1


def test_what_is_not_completed_in_time_is_given_up() -> None:
    fragments = IpReassembly(counts := CaptureCounts())
    fragments.add(part(0, bytes(8), True), 0)
    assert fragments.add(part(8, b"late", False), REASSEMBLY_TIMEOUT) is None
    assert counts.fragments_lost == 1


def test_memory_is_bounded() -> None:
    fragments = IpReassembly(counts := CaptureCounts())
    count = 2 * MEMORY_LIMIT // 60000
    for index in range(count):
        fragments.add(part(0, bytes(60000), True, index.to_bytes(4)), index)
    assert counts.fragments_lost >= count - MEMORY_LIMIT // 60000 - 1
    fragments.close()
    assert counts.fragments_lost == count


def test_packets_that_were_completed_leave_nothing_behind() -> None:
    fragments = IpReassembly(counts := CaptureCounts())
    count = 2 * MEMORY_LIMIT // 60000
    fragments.add(part(0, b"waiting ", True, b"first"), 0)
    for index in range(count):
        fragments.add(part(0, bytes(60000), True), index)
        assert fragments.add(part(60000, b"end", False), index) is not None
    assert counts.fragments_lost == 0
    assert fragments.add(part(8, b"end", False, b"first"), count) == whole(b"waiting end", 0)
