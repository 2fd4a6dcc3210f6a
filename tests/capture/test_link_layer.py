"""Link headers and IP headers, each in every form that captures have them in."""

from __future__ import annotations

import struct

import pytest

from bcapscope.capture.link_layer import IP_OFFSET_FINDERS, NOT_IP, Fragment, IPPacket, find_ip, read_ip
from tests.capture.packets import CLIENT, SERVER, ethernet, ipv4, ipv6

CONTENT = b"what is carried"
V4, V6 = ipv4(CONTENT), ipv6(CONTENT)
PPPOE = struct.pack(">BBHH", 0x11, 0, 1, 2 + len(V4))
SNAP = b"\xaa\xaa\x03\x00\x00\x00"
COOKED = struct.pack(">HHH8s", 0, 1, 6, bytes(8))
COOKED_2_REST = struct.pack(">HIHBB8s", 0, 1, 1, 0, 6, bytes(8))


def _cooked_2(kind: int) -> bytes:
    return struct.pack(">H", kind) + COOKED_2_REST


@pytest.mark.parametrize(
    ("linktype", "data"),
    [
        (1, ethernet(V4)),
        (1, ethernet(V4, tags=[0x8100])),
        (1, ethernet(V4, tags=[0x88A8, 0x8100])),
        (1, ethernet(V4, tags=[0x9100, 0x8100])),
        (1, ethernet(V6, 0x86DD)),
        (1, ethernet(V6, 0x86DD, tags=[0x8100])),
        (1, ethernet(PPPOE + b"\x00\x21" + V4, 0x8864)),
        (1, ethernet(PPPOE + b"\x00\x57" + V6, 0x8864, tags=[0x8100])),
        (1, ethernet(SNAP + b"\x08\x00" + V4, 8 + len(V4))),
        (1, ethernet(SNAP + b"\x86\xdd" + V6, 8 + len(V6), tags=[0x8100])),
        (9, b"\xff\x03\x00\x21" + V4),
        (9, b"\xff\x03\x00\x57" + V6),
        (9, b"\x00\x21" + V4),
        (9, b"\x21" + V4),
        (9, b"\xff\x03\x57" + V6),
        (50, b"\xff\x03\x00\x21" + V4),
        (113, COOKED + b"\x08\x00" + V4),
        (113, COOKED + b"\x00\x04" + SNAP + b"\x08\x00" + V4),
        (113, COOKED + b"\x86\xdd" + V6),
        (113, COOKED + b"\x81\x00\x00\x05\x08\x00" + V4),
        (276, _cooked_2(0x0800) + V4),
        (276, _cooked_2(0x86DD) + V6),
        (276, _cooked_2(4) + SNAP + b"\x08\x00" + V4),
        (276, _cooked_2(0x8100) + b"\x00\x05\x08\x00" + V4),
        (0, b"\x02\x00\x00\x00" + V4),
        (0, b"\x00\x00\x00\x02" + V4),
        *((0, bytes((family, 0, 0, 0)) + V6) for family in (10, 24, 28, 30)),
        (0, b"\x00\x00\x00\x1e" + V6),
        (108, b"\x00\x00\x00\x02" + V4),
        *((linktype, V4) for linktype in (12, 14, 101, 228)),
        *((linktype, V6) for linktype in (12, 14, 101, 229)),
    ],
)
def test_finds_what_is_carried_behind_every_link(linktype: int, data: bytes) -> None:
    offset = find_ip(linktype, data)
    packet = read_ip(data, offset)
    assert packet is not None
    addresses = CLIENT + SERVER if len(packet.addresses) == 8 else bytes(15) + b"\x02" + bytes(15) + b"\x01"
    assert packet == IPPacket(17, addresses, CONTENT, 0, None)


@pytest.mark.parametrize(
    ("linktype", "data"),
    [
        (1, ethernet(b"", 0x0806)),
        (1, ethernet(b"", 0x0806, tags=[0x8100])),
        (1, b"\x08\x00" * 7),
        (1, ethernet(PPPOE + b"\xc0\x21" + V4, 0x8864)),
        (1, ethernet(PPPOE, 0x8864)),
        (1, b""),
        (1, bytes(12) + b"\x81\x00"),
        (1, ethernet(b"\x42\x42\x03" + V4, 3 + len(V4))),
        (1, ethernet(b"\xaa\xaa\x03\x00\x00\x0c\x08\x00" + V4, 8 + len(V4))),
        (1, ethernet(SNAP, 6)),
        (9, b"\xff\x03\xc0\x21" + V4),
        (9, b"\xff\x03"),
        (9, b"\x2d" + V4),
        (9, b""),
        (113, COOKED + b"\x08\x06" + bytes(40)),
        (276, _cooked_2(0x0806) + bytes(40)),
        (0, b"\x07\x00\x00\x00" + V4),
        (0, b"\x02\x00"),
        (101, b""),
    ],
)
def test_tells_what_is_not_ip(linktype: int, data: bytes) -> None:
    assert find_ip(linktype, data) == NOT_IP


def test_ipv4_options_are_passed_over() -> None:
    packet = read_ip(ipv4(CONTENT, options=b"\x94\x04\x00\x00" * 10), 0)
    assert packet is not None
    assert packet.payload == CONTENT


def test_padding_is_not_payload_but_what_is_cut_is_counted() -> None:
    padded, cut = read_ip(V4 + b"padding", 0), read_ip(V4[:-4], 0)
    assert padded is not None
    assert (padded.payload, padded.missing) == (CONTENT, 0)
    assert cut is not None
    assert (cut.payload, cut.missing) == (CONTENT[:-4], 4)
    padded, cut = read_ip(V6 + b"padding", 0), read_ip(V6[:-4], 0)
    assert padded is not None
    assert (padded.payload, padded.missing) == (CONTENT, 0)
    assert cut is not None
    assert (cut.payload, cut.missing) == (CONTENT[:-4], 4)


def test_a_length_left_to_the_network_card_means_all() -> None:
    for packet in (read_ip(ipv4(CONTENT, total=0), 0), read_ip(ipv6(CONTENT, length=0), 0)):
        assert packet is not None
        assert (packet.payload, packet.missing) == (CONTENT, 0)


@pytest.mark.parametrize(
    "data",
    [
        b"\x45",
        V4[:19],
        b"\x44" + V4[1:],
        b"\x4f" + V4[1:],
        ipv4(CONTENT, total=19),
        b"\x55" + V4[1:],
        V6[:39],
        ipv6(b"\x11\x00", following=0),
        ipv6(bytes((17, 9)) + bytes(14), following=0),
        ipv6(b"", following=59),
    ],
)
def test_headers_that_make_no_sense_give_nothing(data: bytes) -> None:
    assert read_ip(data, 0) is None


def test_ipv6_extension_headers_are_passed_over() -> None:
    hop_by_hop = bytes((43, 0)) + bytes(6)
    routing = bytes((60, 1)) + bytes(14)
    destination = bytes((51, 0)) + bytes(6)
    authentication = bytes((17, 2)) + bytes(14)
    data = ipv6(hop_by_hop + routing + destination + authentication + CONTENT, following=0)
    packet = read_ip(data, 0)
    assert packet is not None
    assert (packet.protocol, packet.payload) == (17, CONTENT)


def test_parts_say_what_they_are_parts_of() -> None:
    first = read_ip(ipv4(CONTENT, identification=7, part=0x2000), 0)
    last = read_ip(ipv4(CONTENT, identification=7, part=185), 0)
    assert first is not None
    assert last is not None
    key = CLIENT + SERVER + b"\x00\x07\x11"
    assert (first.fragment, last.fragment) == (Fragment(key, 0, True), Fragment(key, 1480, False))


def test_ipv6_parts_say_what_they_are_parts_of() -> None:
    def part(word: int) -> IPPacket | None:
        return read_ip(ipv6(struct.pack(">BBHI", 17, 0, word, 7) + CONTENT, following=44), 0)

    key = bytes(15) + b"\x02" + bytes(15) + b"\x01" + b"\x00\x00\x00\x07"
    first, last, whole = part(1), part(1480), part(0)
    assert first is not None
    assert last is not None
    assert whole is not None
    assert (first.fragment, first.protocol) == (Fragment(key, 0, True), 17)
    assert last.fragment == Fragment(key, 1480, False)
    assert (whole.fragment, whole.payload) == (None, CONTENT)


@pytest.mark.parametrize("linktype", sorted(IP_OFFSET_FINDERS))
def test_no_cut_raises(linktype: int) -> None:
    for data in (ethernet(V4, tags=[0x8100]), COOKED + b"\x08\x00" + V4, _cooked_2(0x86DD) + V6, V4, V6):
        for cut in range(len(data)):
            offset = find_ip(linktype, data[:cut])
            if offset != NOT_IP:
                read_ip(data[:cut], offset)
