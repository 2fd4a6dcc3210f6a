"""Packets in, observations out: the whole way, for UDP and TCP, in order and out of it."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator

import pytest

from bcapscope.capture import packet_decoder
from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.capture.tcp_reassembly import FIN, RST, SYN
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, Malformed, Problem, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import function_by_name
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Direction,
    Observation,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)
from tests.capture.packets import (
    CLIENT,
    CLIENT_PORT,
    SERVER,
    ethernet,
    from_client,
    from_server,
    ipv4,
    ipv6,
    pcap,
    reply,
    request,
    service_start,
    tcp,
    udp,
)

ETHERNET, RAW = Interface(1, "eth0"), Interface(101)
DOUBTFUL = encode_frame(1, 0, 1)


def captured(*packets: bytes, interface: Interface = ETHERNET) -> Iterator[Packet]:
    return ((time, data, len(data), interface, ()) for time, data in enumerate(packets, 1))


def observe(packets: Iterable[Packet], *ports: int) -> tuple[list[Observation], PacketDecoder]:
    observer = PacketDecoder(ports) if ports else PacketDecoder()
    found = list(observer.decode(packets))
    assert [each.number for each in found] == list(range(1, len(found) + 1))
    assert observer.counts.items == len(found)
    assert set(observer.conversations) == {each.flow.conversation for each in found}
    return found, observer


def raws(found: list[Observation]) -> list[tuple[str, bytes]]:
    return [(str(each.flow.direction), each.item.raw) for each in found]


def test_a_call_and_its_result() -> None:
    found, observer = observe(
        captured(from_client(request(1)), from_server(reply(1)), from_client(request(2)))
    )
    assert raws(found) == [("request", request(1)), ("response", reply(1)), ("request", request(2))]
    assert all(type(each) is Observation and isinstance(each.item, Frame) for each in found)
    assert [(each.time, each.first_byte_time, each.packet) for each in found] == [
        (1, 1, 1),
        (2, 2, 2),
        (3, 3, 3),
    ]
    (conversation,) = observer.conversations
    assert str(conversation.client) == "10.0.0.2:50001"
    assert str(conversation.server) == "10.0.0.1:5007"
    assert (conversation.transport, conversation.server_evidence) == (Transport.UDP, SERVER_PORT)
    assert observer.counts == CaptureCounts(packets=3, items=3)
    assert observer.counts.frames == 3


def test_the_end_is_that_of_all_packets() -> None:
    observer = PacketDecoder()
    assert observer.end_time == 0
    list(observer.decode(captured(from_client(request(1)), b"neither this", b"nor that")))
    assert observer.end_time == 3


def test_the_end_is_known_while_more_packets_are_awaited() -> None:
    observer = PacketDecoder()
    seen = []

    def arriving() -> Iterator[Packet]:
        for packet in captured(from_client(request(1)), b"not b-CAP", from_server(reply(1))):
            yield packet
            seen.append(observer.end_time)

    assert [(each.time, observer.end_time) for each in observer.decode(arriving())] == [(1, 1), (3, 3)]
    assert seen == [1, 2, 3]


def variants() -> dict[str, bytes]:
    """The same frame in packets of every form that is not the most common one."""
    datagram = udp(request(2))
    return {
        "plain": from_client(request(2)),
        "one VLAN tag": ethernet(ipv4(datagram), tags=[0x8100]),
        "two VLAN tags": ethernet(ipv4(datagram), tags=[0x88A8, 0x8100]),
        "IP options": ethernet(ipv4(datagram, options=bytes(8))),
        "may be fragmented": ethernet(ipv4(datagram, part=0)),
        "reserved flag": ethernet(ipv4(datagram, part=0x8000)),
        "length left to the network card": ethernet(ipv4(datagram, total=0)),
        "UDP length left to the network card": ethernet(ipv4(udp(request(2), size=0))),
        "bytes behind the datagram": ethernet(ipv4(datagram + b"\x01\x10")),
        "IP length left, padded": ethernet(ipv4(datagram, total=0) + b"\x01\x10"),
    }


@pytest.mark.parametrize("form", sorted(variants()))
def test_the_quick_way_and_the_long_way_find_the_same(form: str) -> None:
    known, unknown = captured(from_client(request(1)), variants()[form]), captured(variants()[form])
    assert raws(observe(known)[0]) == [("request", request(1)), ("request", request(2))]
    assert raws(observe(unknown)[0]) == [("request", request(2))]


def test_other_links_and_ipv6() -> None:
    found, _ = observe(captured(ipv4(udp(request(1))), ipv6(udp(request(2))), interface=RAW))
    assert raws(found) == [("request", request(1)), ("request", request(2))]
    assert str(found[1].flow.src) == "[::2]:50001"


def test_several_frames_in_a_datagram() -> None:
    for before in ((), (from_client(request(9)),)):
        found, _ = observe(captured(*before, from_client(request(1) + request(2))))
        assert raws(found)[len(before) :] == [("request", request(1)), ("request", request(2))]
        assert {each.packet for each in found[len(before) :]} == {len(before) + 1}


def test_what_is_no_frame_on_the_port_is_told() -> None:
    wrong_end = request(2)[:-1] + b"\x05"
    packets = [from_client(data) for data in (request(1), b"", b"hello", wrong_end, request(3)[:-1])]
    found, observer = observe(captured(*packets))
    assert [type(each.item) for each in found] == [Frame, Malformed, Malformed, Frame, Frame]
    assert [bool(each.item.problems) for each in found] == [False, True, True, True, True]
    assert (observer.counts.malformed, observer.counts.frames) == (2, 3)


def test_other_traffic_is_counted() -> None:
    packets = [
        ethernet(b"arp", 0x0806),
        ethernet(ipv4(b"ping", protocol=1)),
        ethernet(ipv4(udp(b"\x12\x34 some DNS", dport=53))),
        ethernet(ipv4(tcp(b"GET / HTTP/1.1", dport=80), protocol=6)),
        ethernet(ipv4(tcp(b"", dport=80, ack=1), protocol=6)),
        ethernet(ipv4(b"short", protocol=17)),
        ethernet(ipv4(udp(b"", size=7))),
        ethernet(ipv4(b"short", protocol=6)),
        ethernet(ipv4(b"", total=10)),
    ]
    found, observer = observe(captured(*packets))
    assert found == []
    assert observer.counts == CaptureCounts(packets=9, not_ip=1, not_bcap=3, broken=4)
    _, observer = observe(captured(b"radio", interface=Interface(127)))
    assert observer.counts.unknown_links == {127: 1}


def test_unknown_ports_are_told_by_what_is_said() -> None:
    packets = [
        from_client(b"no frame", 15007),
        from_client(DOUBTFUL, 15007),
        from_server(DOUBTFUL, 15007),
        from_client(request(1), 15007),
        from_client(b"damage", 15007),
    ]
    found, observer = observe(captured(*packets))
    assert raws(found) == [
        ("request", DOUBTFUL),
        ("response", DOUBTFUL),
        ("request", request(1)),
        ("request", b"damage"),
    ]
    assert [each.packet for each in found] == [2, 3, 4, 5]
    assert observer.counts.not_bcap == 1
    get_tag = function_by_name("Controller_GetTag")
    assert get_tag is not None
    evidence = ServerEvidence(ServerEvidenceKind.CALL, get_tag.id)
    assert observer.conversations[0].server_evidence == evidence


def test_a_given_port_is_the_servers() -> None:
    found, observer = observe(captured(from_server(b"anything", 1234)), 1234, 5007)
    assert raws(found) == [("response", b"anything")]
    assert observer.conversations[0].server_evidence == SERVER_PORT


def test_both_ends_on_the_port_are_told_by_what_is_said() -> None:
    packets = [ethernet(ipv4(udp(data, 5007, 5007))) for data in (b"?", DOUBTFUL, reply(1))]
    found, _ = observe(captured(*packets))
    assert raws(found) == [("response", b"?"), ("response", DOUBTFUL), ("response", reply(1))]


def test_what_proves_nothing_until_the_end_is_guessed() -> None:
    found, observer = observe(captured(from_server(DOUBTFUL, 1), from_server(DOUBTFUL, 1)))
    assert raws(found) == [("request", DOUBTFUL), ("request", DOUBTFUL)]
    assert observer.conversations[0].server_evidence.kind is ServerEvidenceKind.GUESS


@pytest.mark.parametrize("kept", [42, 44, 57, 60, 70, 85])
def test_what_the_capture_cut_is_not_blamed_on_the_sender(kept: int) -> None:
    whole = from_client(service_start())
    first = from_client(request(1))
    cut = (2, whole[:kept], len(whole), ETHERNET, ())
    size = len(service_start())
    found, observer = observe([*captured(first), cut])
    item = found[1].item
    assert item.raw == service_start()[: kept - 42]
    if kept - 42 < size:
        assert item.problems[-1] == Problem(
            kept - 42, "cut", Message("problem.cut.by-capture", kept=kept - 42, size=size)
        )
    assert observer.counts.cut == (kept < len(whole))


def test_a_datagram_that_ends_early_on_its_own_says_so() -> None:
    found, _ = observe(captured(ethernet(ipv4(udp(request(1), size=8 + len(request(1)) + 40)))))
    reason = "the packet holds 32 of the datagram's 70 bytes"
    assert found[0].item.problems[-1].code == "cut"
    assert str(len(request(1))) in str(found[0].item.problems[-1].reason)
    assert str(found[0].item.problems[-1].reason).startswith(reason[:17])


def test_a_fragmented_datagram_has_the_times_of_its_parts() -> None:
    datagram = udp(service_start())
    parts = [ethernet(ipv4(datagram[:16], part=0x2000)), ethernet(ipv4(datagram[16:], part=2))]
    found, observer = observe(captured(*parts[::-1]))
    assert raws(found) == [("request", service_start())]
    assert (found[0].first_byte_time, found[0].time, found[0].packet) == (1, 2, 2)
    assert observer.counts.fragments_lost == 0
    found, observer = observe(captured(parts[0]))
    assert (found, observer.counts.fragments_lost) == ([], 1)


def client_segment(data: bytes = b"", dport: int = 5007, **header: int) -> bytes:
    return ethernet(ipv4(tcp(data, dport=dport, **header), protocol=6))  # type: ignore[arg-type]


def server_segment(data: bytes = b"", sport: int = 5007, **header: int) -> bytes:
    content = tcp(data, sport=sport, dport=CLIENT_PORT, **header)  # type: ignore[arg-type]
    return ethernet(ipv4(content, SERVER, CLIENT, protocol=6))


def session(port: int = 5007, first: bytes = service_start()) -> list[bytes]:
    size = len(first)
    return [
        client_segment(dport=port, seq=99, flags=SYN),
        server_segment(sport=port, seq=199, ack=100, flags=SYN),
        client_segment(dport=port, seq=100, ack=200),
        client_segment(first, port, seq=100, ack=200),
        server_segment(reply(1), port, seq=200, ack=100 + size),
        client_segment(request(2), port, seq=100 + size, ack=200 + len(reply(1))),
    ]


SAID = [("request", service_start()), ("response", reply(1)), ("request", request(2))]


def test_a_tcp_session() -> None:
    found, observer = observe(captured(*session()))
    assert raws(found) == SAID
    assert [each.packet for each in found] == [4, 5, 6]
    assert {each.flow.conversation.transport for each in found} == {Transport.TCP}
    assert observer.counts == CaptureCounts(packets=6, items=3)


def test_a_tcp_session_on_another_port_is_told_by_its_handshake() -> None:
    found, observer = observe(captured(*session(15007, DOUBTFUL)))
    assert raws(found) == [("request", DOUBTFUL), *SAID[1:]]
    assert observer.conversations[0].server_evidence.kind is ServerEvidenceKind.HANDSHAKE
    assert observer.counts == CaptureCounts(packets=6, items=3)


def test_a_tcp_session_on_another_port_without_its_beginning_is_told_by_what_is_said() -> None:
    found, observer = observe(captured(*session(15007)[4:]))
    assert raws(found) == SAID[1:]
    assert observer.conversations[0].server_evidence.kind is ServerEvidenceKind.RESULT


def test_a_first_frame_in_pieces_on_another_port() -> None:
    start = service_start()
    pieces = [client_segment(start[place : place + 1], 15007, seq=100 + place) for place in range(len(start))]
    found, observer = observe(captured(*session(15007)[:3], *pieces))
    assert raws(found) == SAID[:1]
    assert (found[0].first_byte_time, found[0].time) == (4, 3 + len(start))
    assert observer.counts.not_bcap == 0


def test_other_protocols_that_look_like_a_frame_at_first() -> None:
    fake = b"\x01\x20\x00\x00\x00" + b"\x00" * 26 + b"\x05" + b"x" * 40
    packets = session(15007)[:3]
    for place in range(0, len(fake), 8):
        packets.append(client_segment(fake[place : place + 8], 15007, seq=100 + place))
    found, observer = observe(captured(*packets))
    assert found == []
    assert observer.counts.not_bcap == len(packets) - 3


def test_the_ports_are_used_again() -> None:
    again = [client_segment(seq=7000, flags=SYN), client_segment(request(3), seq=7001)]
    found, observer = observe(captured(*session(), *again))
    assert raws(found) == [*SAID, ("request", request(3))]
    assert len(observer.conversations) == 2


def test_a_hole_is_an_item_of_its_own() -> None:
    packets = session()
    del packets[3]  # Service_Start was sent, for it was answered, but the capture does not have it
    found, observer = observe(captured(*packets))
    assert [str(each.flow.direction) for each in found] == ["response", "request", "request"]
    gap = found[1].item
    assert isinstance(gap, Malformed)
    assert (gap.raw, gap.missing) == (b"", len(service_start()))
    assert (observer.counts.gaps, observer.counts.missing) == (1, len(service_start()))
    assert (observer.counts.malformed, observer.counts.frames) == (0, 2)


def test_contradictions_are_counted() -> None:
    again = client_segment(b"\x01" + bytes(9), seq=100)
    for end in ([], [client_segment(seq=500, flags=RST)]):
        _, observer = observe(captured(*session(), again, *end))
        assert observer.counts.contradictions == 1


def test_what_is_held_back_comes_out_before_the_damage_is_told() -> None:
    data = pcap(
        from_server(DOUBTFUL, 1), client_segment(request(1)[:9], seq=1, flags=FIN), from_client(request(2))
    )
    observer = PacketDecoder()
    found = []
    with pytest.raises(CaptureError, match="inside packet 3"):  # noqa: PT012 - what came before it counts too
        for each in observer.decode(CaptureFile(io.BytesIO(data[:-1]))):
            found.append(each)
    assert [each.item.raw for each in found] == [request(1)[:9], DOUBTFUL]
    assert observer.counts.packets == 2


def test_several_captures_are_numbered_through() -> None:
    observer = PacketDecoder()
    first = list(observer.decode(captured(from_client(request(1)))))
    second = list(observer.decode(captured(from_client(request(2)))))
    assert [(each.number, each.packet) for each in first + second] == [(1, 1), (2, 2)]
    assert first[0].flow is second[0].flow


def test_an_abandoned_observation_keeps_its_counts() -> None:
    observer = PacketDecoder()
    running = observer.decode(
        captured(from_client(request(1)), from_client(request(2)), from_client(request(3)))
    )
    next(running)
    next(running)
    del running
    assert (observer.counts.packets, observer.counts.items) == (2, 2)


def test_directions_of_flows() -> None:
    found, _ = observe(captured(from_client(request(1)), from_server(reply(1))))
    assert [each.flow.direction for each in found] == [Direction.REQUEST, Direction.RESPONSE]
    assert found[0].flow.src_text == found[1].flow.dst_text == "10.0.0.2:50001"
    assert Variant(VT.I4, 7) == found[1].item.arguments[0].variant  # type: ignore[union-attr]


def test_only_one_leg_is_looked_at_and_packets_are_still_counted() -> None:
    near, far = Interface(1, "clients of 127.0.0.1:5008"), Interface(1, "controller 10.0.0.1:5007")
    packets = [
        (1, from_client(request(1)), 100, near, ()),
        (2, from_client(request(1)), 100, far, ()),
        (3, from_client(request(2)), 100, near, ()),
    ]
    observer = PacketDecoder(interface_prefix="clients of ")
    found = list(observer.decode(packets))
    assert [(each.number, each.packet) for each in found] == [(1, 1), (2, 3)]
    assert observer.counts.packets == 3


def test_kept_comments_stay_within_their_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packet_decoder, "COMMENTS_LIMIT", 3)
    monkeypatch.setattr(packet_decoder, "COMMENTS_BYTES", 1000)
    kept = packet_decoder.PacketComments()
    for packet in range(1, 6):
        kept.add(packet, ("short",))
    assert list(kept) == [3, 4, 5]
    kept.add(6, ("long" * 1000,))
    assert list(kept) == [6]
    kept.add(7, ("short",))
    assert list(kept) == [7]
