"""What was said, from what the relay tells."""

from __future__ import annotations

import json
import struct

import pytest

from bcapscope.protocol.codec.frame import Malformed, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy.record_decoder import RecordDecoder
from bcapscope.proxy.relay_session import ClientEndpoints, read_endpoints
from bcapscope.proxy.ring_buffer import RingRecord, RingRecordKind
from bcapscope.traffic.observation import ConnectionEnd, Direction, Endpoint, Observation, Transport
from tests.english import encoded, english

ENDS = [["10.0.0.2", 50001], ["10.0.0.3", 5008], ["10.0.0.3", 50002], ["10.0.0.1", 5007]]
REQUEST, REPLY = encode_frame(7, 0, 2), encode_frame(7, 0, 0)


def opened(transport: str, client: int = 1) -> RingRecord:
    return RingRecord(
        RingRecordKind.CLIENT_OPENED, False, client, 1, 0, json.dumps([transport, *ENDS]).encode(), b""
    )


def data(up: bool, came: int, left: int, raw: bytes, note: str = "", *, client: int = 1) -> RingRecord:
    return RingRecord(RingRecordKind.DATA, up, client, came, left, raw, encoded(note))


def seen(*records: RingRecord) -> list[tuple[Observation, str]]:
    return [(each, english(note)) for each, note in RecordDecoder().decode(records)]


def test_who_met_whom() -> None:
    ends = [Endpoint(host, port) for host, port in ENDS if isinstance(host, str) and isinstance(port, int)]
    assert read_endpoints(opened("tcp").data) == ClientEndpoints(Transport.TCP, *ends)


def test_requests_as_they_came_and_replies_as_they_left() -> None:
    found = seen(opened("udp"), data(True, 10, 20, REQUEST + REQUEST), data(False, 30, 40, REPLY, "late"))
    assert [(each.number, each.time, each.flow.direction, note) for each, note in found] == [
        (1, 10, Direction.REQUEST, ""),
        (2, 10, Direction.REQUEST, ""),
        (3, 40, Direction.RESPONSE, "late"),
    ]
    assert {each.packet for each, _ in found} == {0}  # there is no recording
    conversation = found[0][0].flow.conversation
    assert (str(conversation.client), str(conversation.server)) == ("10.0.0.2:50001", "10.0.0.1:5007")


def test_a_frame_that_comes_in_many_pieces_leaves_the_next_its_arrival_time() -> None:
    long = encode_frame(7, 0, 2, (Variant(VT.BSTR, "x" * 200),))
    pieces = [long[index : index + 1] for index in range(len(long))]
    assert len(pieces) > 300
    first, last = pieces[:256], b"".join(pieces[256:]) + REQUEST[:5]  # the 257th piece begins the next frame
    records = [data(True, 10 + index, 0, each) for index, each in enumerate([*first, last, REQUEST[5:]])]
    found = [each for each, _ in seen(opened("tcp"), *records)]
    assert [(each.first_byte_time, each.time) for each in found] == [(10, 266), (266, 267)]


def test_a_frame_that_comes_in_many_pieces_keeps_its_own_arrival_time() -> None:
    first, second = (encode_frame(7, 0, 2, (Variant(VT.BSTR, "x" * size),)) for size in (90, 100))
    pieces = [(first + second)[index : index + 1] for index in range(len(first + second))]
    pieces[len(first) - 1 : len(first) + 1] = [first[-1:] + second[:1]]
    records = [data(True, 10 + index, 0, each) for index, each in enumerate(pieces)]
    found = [each for each, _ in seen(opened("tcp"), *records)]
    began = 10 + len(first) - 1
    assert 128 < len(first) < 256 < len(pieces)
    assert [each.first_byte_time for each in found] == [10, began]


def test_what_rules_lost_was_said_but_not_heard() -> None:
    lost = seen(opened("udp"), data(True, 10, 0, REQUEST, "lost"), data(False, 30, 0, REPLY, "lost"))
    assert [(each.flow.direction, note) for each, note in lost] == [(Direction.REQUEST, "lost")]
    made_up = seen(opened("udp"), data(True, 0, 20, REQUEST), data(False, 0, 40, REPLY))
    assert [each.time for each, _ in made_up] == [40]


@pytest.mark.parametrize(
    "disturbed",
    [
        pytest.param(data(True, 10, 0, REQUEST), id="dropped"),
        pytest.param(data(False, 0, 20, REPLY), id="invented"),
        pytest.param(data(True, 10, 20, REQUEST, "late"), id="noted"),
    ],
)
def test_the_controllers_side_is_decoded_once_the_proxy_disturbs_a_message(disturbed: RingRecord) -> None:
    joined: list[tuple[str, str]] = []
    decoder = RecordDecoder(lambda near, far: joined.append((str(near.client), str(far.client))))
    assert len(list(decoder.decode([opened("udp"), data(True, 1, 2, REQUEST)]))) == 1
    assert joined == []
    list(decoder.decode([disturbed]))
    later = [each for each, _ in decoder.decode([data(True, 30, 31, REQUEST)])]
    assert [(each.number > 0, each.time) for each in later] == [(True, 30), (False, 31)]
    assert joined == [("10.0.0.2:50001", "10.0.0.3:50002")]


def test_both_sides_of_a_disturbed_conversation_are_told_from_its_sender_on() -> None:
    decoder = RecordDecoder(lambda near, far: None)
    records = [
        opened("udp", 1),
        opened("udp", 2),
        data(True, 1, 2, REQUEST),
        data(True, 10, 11, REQUEST, "late"),
        data(False, 20, 21, REPLY, "late"),
        data(True, 30, 0, REQUEST, "lost"),
        data(False, 0, 41, REPLY, "made up"),
        data(True, 50, 51, REQUEST, client=9),
        data(True, 60, 61, REQUEST, client=2),
    ]
    found = [
        (each.number, each.time, each.packet, type(each) is Observation)
        for each, _ in decoder.decode(records, range(101, 110))
    ]
    assert found == [
        (1, 1, 103, True),
        (2, 10, 104, False),
        (0, 11, 0, False),
        (0, 20, 0, False),
        (3, 21, 105, False),
        (4, 30, 106, False),
        (5, 41, 107, False),
        (6, 60, 109, True),
    ]


def test_pieces_of_several_streams_are_read_together() -> None:
    records = [
        opened("tcp", 1),
        opened("tcp", 2),
        data(True, 10, 11, REQUEST[:5]),
        data(True, 12, 13, REQUEST[:6], client=2),
        RingRecord(RingRecordKind.HOLE, False, 2, 14, 15, struct.pack("=QQ", 5, 5), b""),
        data(True, 16, 17, REQUEST[5:]),
        data(True, 18, 19, REQUEST[6:], client=2),
    ]
    found = [each for each, _ in seen(*records) if not isinstance(each.item, Malformed)]
    assert [(each.first_byte_time, each.time) for each in found] == [(10, 16), (12, 18)]


def test_a_frame_behind_a_hole_has_the_time_of_its_first_byte() -> None:
    hole = struct.pack("=QQ", 500, 500)
    found = seen(
        opened("tcp"),
        data(True, 10, 11, REQUEST + REQUEST[:4]),
        RingRecord(RingRecordKind.HOLE, True, 1, 20, 21, hole, b""),
        data(True, 30, 31, REQUEST[:4]),
        data(True, 40, 41, REQUEST[4:] + REQUEST[:4]),
        data(True, 50, 51, REQUEST[4:]),
    )
    frames = [each for each, _ in found if not isinstance(each.item, Malformed)]
    assert [(each.first_byte_time, each.time) for each in frames] == [(10, 10), (30, 40), (40, 50)]


def test_streams_are_put_together_with_the_times_of_their_pieces() -> None:
    found = seen(
        opened("tcp"),
        data(True, 10, 11, REQUEST[:5]),
        data(True, 20, 21, REQUEST[5:] + REQUEST[:3]),
        data(True, 30, 31, REQUEST[3:]),
        data(False, 35, 36, REPLY[:4]),
        RingRecord(RingRecordKind.END, True, 1, 40, 0, b"", b""),
        RingRecord(RingRecordKind.END, True, 1, 0, 41, b"", b""),
        RingRecord(RingRecordKind.CLIENT_CLOSED, False, 1, 50, 0, encoded("why"), b""),
    )
    assert [(each.first_byte_time, each.time) for each, _ in found] == [(10, 20), (20, 30), (36, 50)]
    assert isinstance(found[2][0].item, Malformed)
    assert found[0][0].flow.conversation.connection_end == ConnectionEnd(Direction.REQUEST, False, 40)


@pytest.mark.parametrize("up", [True, False])
def test_a_hole_in_a_stream_is_seen_where_it_is(up: bool) -> None:
    raw = REQUEST if up else REPLY
    hole = struct.pack("=QQ", *((5, 3) if up else (3, 5)))
    found = seen(
        opened("tcp"),
        data(up, 10, 11, raw + raw[:4]),
        RingRecord(RingRecordKind.HOLE, up, 1, 20, 21, hole, b""),
        data(up, 30, 31, raw),
    )
    decoder = RecordDecoder()
    list(decoder.decode([opened("tcp"), RingRecord(RingRecordKind.HOLE, up, 1, 20, 21, hole, b"")]))
    assert list(decoder.last_heard.values()) == [20 if up else 1]
    items = [each.item for each, _ in found]
    gaps = [item.missing for item in items if isinstance(item, Malformed) and item.missing]
    assert gaps == [5]
    assert [each.time for each, _ in found][-2:] == ([20, 30] if up else [21, 31])
    assert not isinstance(items[-1], Malformed)


@pytest.mark.parametrize("reset", [True, False])
@pytest.mark.parametrize("up", [True, False])
def test_a_connection_is_ended_by_the_side_from_which_its_end_came(up: bool, reset: bool) -> None:
    how, other = (
        (RingRecordKind.RESET, RingRecordKind.END) if reset else (RingRecordKind.END, RingRecordKind.RESET)
    )
    ((seen_, _),) = seen(
        opened("tcp"),
        data(up, 10, 11, REQUEST),
        RingRecord(how, up, 1, 20, 0, b"", b""),
        RingRecord(how, up, 1, 0, 30, b"", b""),
        RingRecord(other, not up, 1, 40, 0, b"", b""),
    )
    direction = Direction.REQUEST if up else Direction.RESPONSE
    assert seen_.flow.conversation.connection_end == ConnectionEnd(direction, reset, 20, both_ended=True)


def test_what_the_proxy_ends_is_ended_by_neither_side() -> None:
    begun = REPLY[:4]
    ends = [RingRecord(RingRecordKind.RESET, up, 1, 0, 20, b"a rule", b"") for up in (True, False)]
    ((seen_, _),) = seen(opened("tcp"), data(False, 10, 11, begun), *ends)
    assert (seen_.time, seen_.flow.conversation.connection_end) == (20, None)


def test_long_streams_keep_few_times() -> None:
    decoder = RecordDecoder()
    list(decoder.decode([opened("tcp")]))
    large = encode_frame(1, 0, 1, ())[:1] + (1 << 20).to_bytes(4, "little") + bytes(1 << 19)
    for start in range(0, len(large), 100):
        list(decoder.decode([data(True, start + 1, start + 2, large[start : start + 100])]))
    way = decoder._clients[1].streams[True][0]
    assert len(way.arrival_times) <= 1025


@pytest.mark.parametrize("before", [[], [data(True, 5, 6, REQUEST)]], ids=["first", "later"])
def test_a_frame_of_many_pieces_keeps_the_time_of_its_first_byte(before: list[RingRecord]) -> None:
    large = encode_frame(8, 0, 64, (Variant.array(VT.UI1, bytes(3000)),))
    pieces = [data(True, 10 + at, 11 + at, large[at : at + 2]) for at in range(0, len(large), 2)]
    *_, (found, _) = seen(opened("tcp"), *before, *pieces)
    assert not isinstance(found.item, Malformed)
    assert (found.item.raw, found.first_byte_time) == (large, 10)


def test_what_is_lost_before_the_first_byte_belongs_to_no_packet() -> None:
    hole = RingRecord(RingRecordKind.HOLE, True, 1, 20, 21, struct.pack("=QQ", 5, 5), b"")
    ((found, _),) = seen(opened("tcp"), hole)
    assert (found.time, found.first_byte_time, found.packet) == (20, 20, 0)


def test_clients_are_known_until_they_are_gone() -> None:
    decoder = RecordDecoder()
    list(decoder.decode([opened("udp", 1), opened("tcp", 2)]))
    assert sorted(decoder.client_numbers.values()) == [1, 2]
    assert decoder.pop_closed_clients() == []
    list(
        decoder.decode(
            [
                RingRecord(RingRecordKind.CLIENT_CLOSED, False, 2, 9, 0, encoded("reset"), b""),
                data(True, 1, 2, REQUEST, client=2),
            ]
        )
    )
    ((conversation, why),) = decoder.pop_closed_clients()
    assert (conversation.transport, str(why)) == (Transport.TCP, "reset")
    assert (decoder.pop_closed_clients(), list(decoder.client_numbers.values())) == ([], [1])
    brief = RingRecord(RingRecordKind.CLIENT_CLOSED, False, 3, 9, 0, encoded("in the same look"), b"")
    list(decoder.decode([opened("udp", 3), brief]))
    assert [str(why) for _, why in decoder.pop_closed_clients()] == ["in the same look"]
    assert decoder.observation_count == 0


def test_when_each_client_was_heard() -> None:
    decoder = RecordDecoder()
    list(decoder.decode([opened("udp"), data(False, 30, 40, REPLY)]))
    assert list(decoder.last_heard.values()) == [1]
    list(decoder.decode([data(True, 50, 60, REQUEST)]))
    assert list(decoder.last_heard.values()) == [50]
