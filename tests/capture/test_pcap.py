"""The classic capture file: byte orders, resolutions, and every way to be cut."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from scapy.utils import RawPcapReader, RawPcapWriter

from bcapscope.capture.capture_file import CaptureFile, open_capture
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.pcap import RECORD_LIMIT
from bcapscope.errors import CaptureError
from tests.capture.packets import START, pcap, pcap_header, pcap_record


def read(data: bytes) -> list[Packet]:
    return list(CaptureFile(io.BytesIO(data)))


def read_until_damage(data: bytes) -> tuple[list[Packet], CaptureError]:
    packets = []
    with pytest.raises(CaptureError) as caught:  # noqa: PT012 - what came before the error counts too
        for packet in CaptureFile(io.BytesIO(data)):
            packets.append(packet)
    return packets, caught.value


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "fraction"), [(0xA1B2C3D4, 123456), (0xA1B23C4D, 123456000)])
def test_reads_both_byte_orders_and_resolutions(order: str, magic: int, fraction: int) -> None:
    data = pcap_header(101, order, magic) + pcap_record(b"abc", 1_700_000_000, fraction, order, 99)
    assert read(data) == [(START + 123_456_000, b"abc", 99, Interface(101), ())]


def test_keeps_every_nanosecond() -> None:
    data = pcap_header(magic=0xA1B23C4D) + pcap_record(b"", 1_700_000_000, 123456789)
    assert read(data)[0][0] == 1_700_000_000_123_456_789


def test_link_type_is_told_from_the_length_of_a_check_sequence() -> None:
    assert read(pcap_header(1 | 0x24000000) + pcap_record(b"x"))[0][3] == Interface(1)


def test_a_capture_without_packets_is_sound() -> None:
    assert read(pcap()) == []


def test_every_cut_leaves_the_packets_before_it() -> None:
    data = pcap(b"first", b"", b"third packet")
    whole = read(data)
    ends = [24, 24 + 21, 24 + 21 + 16, len(data)]
    for cut in range(4, len(data)):
        if cut in ends:
            assert read(data[:cut]) == whole[: ends.index(cut)]
            continue
        packets, error = read_until_damage(data[:cut])
        assert packets == whole[: len(packets)]
        assert len(packets) == sum(end <= cut for end in ends[1:])
        assert error.offset == max([0, *(end for end in ends if end < cut)])


def test_says_where_it_breaks_off() -> None:
    _, error = read_until_damage(pcap(b"abcdef", b"ghijkl")[:-4])
    assert str(error) == "the capture ends inside packet 2 (byte 46), which has 18 bytes"


def test_a_claim_is_not_believed_beyond_the_limit() -> None:
    huge = pcap_record(bytes(RECORD_LIMIT))
    assert len(read(pcap_header() + huge)[0][1]) == RECORD_LIMIT
    packets, error = read_until_damage(
        pcap(b"good") + pcap_record(bytes(RECORD_LIMIT + 1)) + pcap_record(b"x")
    )
    assert len(packets) == 1
    assert (
        str(error)
        == "the capture is damaged at packet 2 (byte 44): it claims 262145 bytes; the limit is 262144"
    )


def test_agrees_with_scapy_on_a_file_scapy_wrote(tmp_path: Path) -> None:
    path = str(tmp_path / "scapy.pcap")
    with RawPcapWriter(path, linktype=1, nano=True) as writer:
        writer.write_header(None)
        for size in (0, 1, 60, 1500, 60000):
            writer.write_packet(bytes(size), sec=1_700_000_000 + size, usec=size * 7, wirelen=size + 3)
    with open_capture(path) as capture, RawPcapReader(path) as peer:
        ours = [(time, data, original) for time, data, original, *_ in capture]
        theirs = [(m.sec * 10**9 + m.usec, data, m.wirelen) for data, m in peer]
    assert ours == theirs
    assert len(ours) == 5
