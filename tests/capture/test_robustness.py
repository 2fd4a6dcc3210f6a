"""Whatever a capture holds, reading it gives observations and at most a CaptureError."""

from __future__ import annotations

import gzip
import io

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.link_layer import IP_OFFSET_FINDERS
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.observation import Observation
from tests.capture.packets import (
    enhanced,
    ethernet,
    from_client,
    from_server,
    interface,
    ipv4,
    ipv6,
    obsolete,
    option,
    pcap,
    reply,
    request,
    section,
    service_start,
    simple,
    tcp,
    udp,
)

PACKETS = [
    from_client(service_start()),
    from_server(reply(1)),
    from_client(request(2), 15007),
    ethernet(ipv4(tcp(seq=9, flags=2), protocol=6)),
    ethernet(ipv4(tcp(service_start(), seq=10, ack=1), protocol=6)),
    ethernet(ipv4(tcp(request(2) + request(3)[:9], seq=99), protocol=6)),
    ethernet(ipv4(udp(request(3))[:16], part=0x2000)),
    ethernet(ipv4(udp(request(3))[16:], part=2)),
    ethernet(ipv6(bytes((17, 0)) + bytes(6) + udp(request(4)), following=0), 0x86DD, tags=[0x8100]),
]
CAPTURES = [
    pcap(*PACKETS),
    section() + interface(options=option(9, b"\x09")) + b"".join(map(enhanced, PACKETS)),
    section(">") + interface(order=">") + simple(PACKETS[0], ">") + obsolete(PACKETS[1], order=">"),
    gzip.compress(pcap(*PACKETS), mtime=0),
]


def observe(data: bytes) -> list[Observation]:
    observer = PacketDecoder()
    found = []
    try:
        for each in observer.decode(CaptureFile(io.BytesIO(data))):
            found.append(each)
    except CaptureError as error:
        sentence = str(error)
    else:
        sentence = "sound"
    assert sentence.strip()
    assert "\n" not in sentence
    assert observer.counts.items == len(found)
    for each in found:
        assert 1 <= each.packet <= observer.counts.packets
        assert each.item.problems or isinstance(each.item, Frame)
    return found


@st.composite
def damaged_captures(draw: st.DrawFn) -> bytes:
    data = bytearray(draw(st.sampled_from(CAPTURES)))
    for _ in range(draw(st.integers(0, 4))):
        place = draw(st.integers(0, len(data) - 1))
        match draw(st.sampled_from(["change", "cut out", "insert", "end"])):
            case "change":
                data[place : place + 4] = draw(st.binary(min_size=1, max_size=4))
            case "cut out":
                del data[place : place + draw(st.integers(1, 40))]
            case "insert":
                data[place:place] = draw(st.binary(min_size=1, max_size=40))
            case _:
                del data[place:]
        data = data or bytearray(b"\x00")
    return bytes(data)


@given(damaged_captures())
def test_a_damaged_capture_never_raises_anything_else(data: bytes) -> None:
    observe(data)


@given(st.binary(max_size=200))
def test_no_bytes_raise_anything_else(data: bytes) -> None:
    observe(data)
    observe(CAPTURES[0][:24] + data)
    observe(CAPTURES[1][:28] + data)
    observe(b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03" + data)


@given(
    st.sampled_from([*IP_OFFSET_FINDERS, 127]),
    st.lists(st.binary(max_size=120) | st.sampled_from(PACKETS), max_size=8),
)
def test_no_packets_raise_anything(linktype: int, packets: list[bytes]) -> None:
    where = Interface(linktype)
    captured: list[Packet] = [(time, data, len(data) + 5, where, ()) for time, data in enumerate(packets)]
    list(PacketDecoder().decode(captured))


def test_every_cut_of_a_capture_gives_frames_of_the_whole() -> None:
    for data in CAPTURES:
        whole = sound(data)
        for cut in range(len(data)):
            assert sound(data[:cut]) <= whole
        assert len(whole) > 1


def sound(data: bytes) -> set[tuple[str, bytes]]:
    found = observe(data)
    return {(each.flow.src_text, each.item.raw) for each in found if not each.item.problems}
