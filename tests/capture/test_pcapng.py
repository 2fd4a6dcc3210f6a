"""The pcapng capture file: blocks, sections, clocks, comments, and every way to be damaged."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from scapy.packet import Raw
from scapy.utils import RawPcapNgReader, wrpcapng

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.pcapng import BLOCK_LIMIT, INTERFACES_LIMIT
from bcapscope.errors import CaptureError
from tests.capture.packets import (
    END_OF_OPTIONS,
    START,
    block,
    enhanced,
    interface,
    obsolete,
    option,
    section,
    simple,
)
from tests.capture.test_pcap import read, read_until_damage

TICKS = 1_700_000_000_123_456
TIME = START + 123_456_000


@pytest.mark.parametrize("order", ["<", ">"])
def test_reads_every_kind_of_packet_block(order: str) -> None:
    data = (
        section(order)
        + interface(113, order=order)
        + enhanced(b"enhanced", TICKS, order=order, original=70)
        + simple(b"simple", order=order)
        + obsolete(b"obsolete", TICKS + 1, order=order)
    )
    where = Interface(113)
    assert read(data) == [
        (TIME, b"enhanced", 70, where, ()),
        (TIME, b"simple", 6, where, ()),
        (TIME + 1000, b"obsolete", 8, where, ()),
    ]


def test_other_blocks_are_passed_over() -> None:
    others = b"".join(block(kind, b"whatever") for kind in (4, 5, 10, 0xBAD, 0x80000001, 0xFFFFFFFF))
    assert [
        packet[1] for packet in read(section() + others + interface() + others + enhanced(b"x") + others)
    ] == [b"x"]


def test_each_section_has_its_own_order_and_interfaces() -> None:
    data = (
        section("<")
        + interface(1)
        + interface(101)
        + enhanced(b"a", number=1)
        + section(">")
        + interface(276, order=">")
        + enhanced(b"b", order=">")
        + section("<")
        + interface(0)
        + enhanced(b"c")
    )
    assert [(packet[1], packet[3].linktype) for packet in read(data)] == [(b"a", 101), (b"b", 276), (b"c", 0)]


@pytest.mark.parametrize(
    ("resolution", "ticks", "time"),
    [
        (6, 1_500_000, 1_500_000_000),
        (9, 1_700_000_000_123_456_789, 1_700_000_000_123_456_789),
        (3, 1_500, 1_500_000_000),
        (0, 1_700_000_000, START),
        (12, 1_500_000_000_999, 1_500_000_000),
        (0x80 | 10, 1536, 1_500_000_000),
        (0x80 | 30, 3 << 29, 1_500_000_000),
        (0x80, 7, 7_000_000_000),
    ],
)
@pytest.mark.parametrize("offset", [0, 1_700_000_000, -1])
def test_time_units_and_offsets(resolution: int, ticks: int, time: int, offset: int) -> None:
    options = option(9, bytes((resolution,))) + option(14, struct.pack("<q", offset)) + END_OF_OPTIONS
    data = section() + interface(options=options) + enhanced(b"", ticks)
    assert read(data)[0][0] == time + offset * 1_000_000_000


def test_each_interface_keeps_its_own_clock_and_name() -> None:
    nanoseconds = option(2, b"lo") + option(9, b"\x09")
    data = section() + interface(options=option(2, "ネット".encode())) + interface(options=nanoseconds)
    high = 3 << 32
    data += (
        enhanced(b"", high + 5)
        + enhanced(b"", high + 5, number=1)
        + enhanced(b"", 5, number=1)
        + enhanced(b"", 5)
    )
    assert [(packet[0], packet[3].name) for packet in read(data)] == [
        ((high + 5) * 1000, "ネット"),
        (high + 5, "lo"),
        (5, "lo"),
        (5000, "ネット"),
    ]


@pytest.mark.parametrize("maker", [enhanced, obsolete])
def test_comments_are_kept(maker: object) -> None:
    options = (
        option(1, b"first") + option(2, bytes(4)) + option(1, "zweit\xe4".encode("latin-1")) + END_OF_OPTIONS
    )
    data = section() + interface() + maker(b"abc", options=options) + enhanced(b"none")  # type: ignore[operator]
    assert [packet[4] for packet in read(data)] == [("first", "zweit\ufffd"), ()]


def test_a_simple_packet_is_as_long_as_its_interface_keeps() -> None:
    data = section() + interface(snaplen=4) + simple(b"abcd", original=1000)
    assert read(data) == [(0, b"abcd", 1000, Interface(1), ())]


def test_every_cut_leaves_the_packets_before_it() -> None:
    parts = [
        section(),
        interface(),
        enhanced(b"first", TICKS),
        enhanced(b"2", TICKS, options=option(1, b"comment")),
        simple(b"third"),
        obsolete(b"4"),
        block(0xBAD, b"unknown"),
        enhanced(b"last"),
    ]
    data = b"".join(parts)
    ends = [len(b"".join(parts[:count])) for count in range(1, len(parts) + 1)]
    whole = read(data)
    for cut in range(4, len(data)):
        if cut in ends:
            packets = read(data[:cut])
        else:
            packets, error = read_until_damage(data[:cut])
            assert error.offset == max([0, *(end for end in ends if end < cut)])
        assert packets == whole[: len(packets)]
        assert len(packets) == sum(end <= cut for index, end in enumerate(ends) if index in (2, 3, 4, 5, 7))


BEFORE = section() + interface() + enhanced(b"good", TICKS)


def _with_length(data: bytes, length: int) -> bytes:
    return data[:4] + struct.pack("<I", length) + data[8:]


@pytest.mark.parametrize(
    ("damaged", "why"),
    [
        (
            _with_length(enhanced(b"bad!"), 40),
            "a block is 40 bytes long at its beginning and 3149642683 at its end",
        ),
        (_with_length(enhanced(b"bad!"), 8), "a block claims a length of 8 bytes"),
        (_with_length(enhanced(b"bad!"), 37), "a block claims a length of 37 bytes"),
        (_with_length(block(9, b""), BLOCK_LIMIT + 4), "a block claims a length of 16777220 bytes"),
        (enhanced(b"bad!", number=1), "a packet names interface 1, which the capture does not describe"),
        (enhanced(b"bad!", kept=5), "a packet claims 5 bytes; its block has room for 4"),
        (enhanced(b"bad!", kept=0xFFFFFFFF), "a packet claims 4294967295 bytes; its block has room for 4"),
        (simple(b"bad!", original=99), "a packet claims 99 bytes; its block has room for 4"),
        (enhanced(b"", options=b"\x01\x00\xff\x00"), "an option claims 255 bytes; its block has 0 left"),
        (block(6, b"tiny"), "the block is too small, with 4 bytes"),
        (block(1, b""), "the block is too small, with 0 bytes"),
        (interface(options=option(14, b"tiny")), "the block is too small, with 4 bytes"),
        (block(0x0A0D0D0A, b"nonsense"), "a section header block lacks its byte-order magic"),
        (section(version=2), "a section has pcapng version 2.0; bcapscope reads only version 1"),
        (section() + simple(b""), "a packet names interface 0, which the capture does not describe"),
    ],
)
def test_damage_is_named(damaged: bytes, why: str) -> None:
    tail = bytes.fromhex("bbbbbbbb") * 20
    packets, error = read_until_damage(BEFORE + damaged + tail)
    assert [packet[1] for packet in packets] == [b"good"]
    assert str(error).split(": ", 1)[1] == why
    assert error.offset == len(BEFORE) + (
        len(section()) if why.startswith("a packet names interface 0") else 0
    )
    assert str(error).startswith(f"the capture is damaged at byte {error.offset}, after 1 packets: ")


def test_interfaces_are_bounded() -> None:
    packets, error = read_until_damage(section() + interface() * (INTERFACES_LIMIT + 1))
    assert packets == []
    assert "more than 65536 interfaces" in str(error)


def test_agrees_with_scapy_on_a_file_scapy_wrote(tmp_path: Path) -> None:
    path = str(tmp_path / "scapy.pcapng")
    packets = [Raw(bytes(size)) for size in (1, 2, 3, 60, 1500)]
    for index, packet in enumerate(packets):
        packet.time, packet.wirelen = 1_700_000_000 + index / 8, 2000
        packet.comments, packet.sniffed_on = [b"said", b"twice"], f"eth{index % 2}"
    wrpcapng(path, packets)
    with open_capture(path) as capture, RawPcapNgReader(path) as peer:
        theirs = [
            ((m.tshigh << 32 | m.tslow) * 1000, data, m.wirelen, m.linktype, m.ifname, m.comments)
            for data, m in peer
        ]
        assert [_as_scapy_has_it(packet) for packet in capture] == theirs
    assert len(theirs) == 5


def _as_scapy_has_it(packet: Packet) -> tuple[object, ...]:
    time, data, original, where, comments = packet
    return time, data, original, where.linktype, where.name.encode(), [text.encode() for text in comments]


def test_a_truncated_error_is_a_capture_error() -> None:
    packets, error = read_until_damage(BEFORE + enhanced(b"bad!")[:-1])
    assert isinstance(error, CaptureError)
    assert str(error) == f"the capture ends inside the block at byte {len(BEFORE)}, after 1 packets"
    assert len(packets) == 1
