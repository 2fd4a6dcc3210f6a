"""TCP put together: whatever the network and the capture do to the segments, the frames are the same."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.link_layer import read_ip
from bcapscope.capture.role_detection import TimedItem
from bcapscope.capture.tcp_reassembly import (
    ACK,
    ACK_LIMIT,
    FIN,
    MARKS_LIMIT,
    REORDER_LIMIT,
    RST,
    SYN,
    TcpConnection,
    TcpSegment,
    TcpStream,
    read_segment,
)
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, Malformed
from tests.capture.packets import ipv4, reply, request, tcp

FRAMES = [request(1), reply(1), request(2, 21), request(3)]
CONTENT = b"".join(FRAMES)


class Part(NamedTuple):
    start: int
    stop: int


def segment(start: int, data: bytes, flags: int = ACK, ack: int = 0, missing: int = 0) -> TcpSegment:
    return TcpSegment(flags, start % 2**32, ack % 2**32, data, missing)


def stream(origin: int = 0, from_start: bool = True) -> TcpStream:
    made = TcpStream(ByteBudget())
    made.begin(origin, from_start)
    return made


def raws(sightings: list[TimedItem]) -> list[bytes]:
    return [timed_item.item.raw for timed_item in sightings]


def hole(timed_item: TimedItem) -> int:
    assert isinstance(timed_item.item, Malformed)
    return timed_item.item.missing


def test_reads_the_header() -> None:
    payload = tcp(b"data", seq=7, ack=9, flags=FIN, options=b"\x01" * 12)
    assert read_segment(payload, 0) == TcpSegment(FIN | ACK, 7, 9, b"data", 0)
    assert read_segment(payload, 3) == TcpSegment(FIN | ACK, 7, 9, b"data", 3)
    assert read_segment(payload[:26], 10) == TcpSegment(FIN | ACK, 7, 9, b"", 4)
    for broken in (
        payload[:19],
        payload[:12] + b"\x40" + payload[13:],
        payload[:12] + b"\xf0" + payload[13:],
    ):
        assert read_segment(broken, 0) is None


def test_padding_of_the_link_is_no_data() -> None:
    packet = read_ip(ipv4(tcp(ack=1), protocol=6) + bytes(6), 0)
    assert packet is not None
    found = read_segment(packet.payload, packet.missing)
    assert found is not None
    assert found.data == b""


@given(data=st.data(), origin=st.sampled_from([0, 1, 2**31 - 40, 2**32 - 1, 2**32 - 50]))
def test_any_cutting_reordering_repetition_and_overlap_gives_the_same_frames(
    data: st.DataObject, origin: int
) -> None:
    cuts = sorted(data.draw(st.sets(st.integers(1, len(CONTENT) - 1))))
    parts = [Part(a, b) for a, b in zip([0, *cuts], [*cuts, len(CONTENT)], strict=True)]
    places = st.integers(0, len(CONTENT))
    again = data.draw(
        st.lists(st.builds(lambda a, b: Part(min(a, b), max(a, b)), places, places), max_size=5)
    )
    order = data.draw(st.permutations(parts + again))
    made = stream(origin)
    found: list[TimedItem] = []
    for number, (start, stop) in enumerate(order):
        found += made.receive(segment(origin + start, CONTENT[start:stop]), number, number)
    assert raws(found) == FRAMES
    assert made.contradictions == 0
    assert made.close(99, 99) == []
    arrival: dict[int, int] = {}
    for number, (start, stop) in enumerate(order):
        for place in range(start, stop):
            arrival.setdefault(place, number)
    begin = 0
    for timed_item in found:
        own = [arrival[place] for place in range(begin, begin + len(timed_item.item.raw))]
        assert (timed_item.began, timed_item.time, timed_item.packet) == (own[0], max(own), max(own))
        begin += len(own)


def test_glued_frames_share_the_times_of_their_segment() -> None:
    assert stream().receive(segment(0, CONTENT), 5, 3) == [TimedItem(5, 5, 3, Frame(raw)) for raw in FRAMES]


def test_a_frame_cut_in_two_has_the_times_of_both() -> None:
    made = stream()
    first, second = FRAMES[:2]
    assert made.receive(segment(0, first[:10]), 5, 3) == []
    found = made.receive(segment(10, first[10:] + second[:4]), 6, 4)
    assert found == [TimedItem(5, 6, 4, Frame(first))]
    found = made.receive(segment(len(first) + 4, second[4:]), 7, 5)
    assert found == [TimedItem(6, 7, 5, Frame(second))]


def test_a_stream_that_began_before_the_capture_gets_into_step() -> None:
    made = stream(1000, from_start=False)
    found = made.receive(segment(1000, FRAMES[0][7:] + FRAMES[1]), 1, 1)
    assert raws(found) == [FRAMES[0][7:], FRAMES[1]]
    assert isinstance(found[0].item, Malformed)


def test_a_hole_waits_for_its_bytes() -> None:
    made = stream()
    assert made.receive(segment(len(FRAMES[0]), FRAMES[1]), 1, 1) == []
    assert raws(made.receive(segment(0, FRAMES[0]), 2, 2)) == FRAMES[:2]


def test_a_hole_that_the_other_end_has_is_lost() -> None:
    made = stream()
    begin = len(FRAMES[0])
    assert made.receive(segment(begin, FRAMES[1]), 1, 1) == []
    assert made.acknowledge(begin - 1, 2, 2) == []
    found = made.acknowledge(begin, 3, 3)
    assert hole(found[0]) == begin
    assert (found[0].began, found[0].time, found[0].packet) == (3, 3, 3)
    assert found[1] == TimedItem(1, 1, 1, Frame(FRAMES[1]))
    assert made.receive(segment(begin + len(FRAMES[1]), FRAMES[2]), 4, 4) == [
        TimedItem(4, 4, 4, Frame(FRAMES[2]))
    ]


def test_a_hole_in_a_frame_ends_the_frame() -> None:
    made = stream()
    made.receive(segment(0, FRAMES[0][:20]), 1, 1)
    made.receive(segment(len(FRAMES[0]), FRAMES[1]), 2, 2)
    broken, gap, sound = made.acknowledge(len(FRAMES[0]), 3, 3)
    assert broken.item.raw == FRAMES[0][:20]
    assert broken.item.problems
    assert hole(gap) == len(FRAMES[0]) - 20
    assert sound.item == Frame(FRAMES[1])


def test_a_hole_is_given_up_when_too_much_waits_behind_it() -> None:
    made = stream()
    found: list[TimedItem] = []
    place = 1
    while not found and place < 2 * REORDER_LIMIT:
        found = made.receive(segment(place, CONTENT * 20), place, place)
        place += len(CONTENT) * 20
    assert REORDER_LIMIT * 0.8 < place < REORDER_LIMIT * 1.1
    assert hole(found[0]) == 1
    assert raws(found[1 : 1 + len(FRAMES)]) == FRAMES


def test_the_end_gives_out_what_was_held_back_with_all_its_holes() -> None:
    made = stream()
    first, second, third, _ = FRAMES
    made.receive(segment(0, first + second[:9]), 1, 1)
    place = len(first + second)
    made.receive(segment(place + 5, third), 2, 2)
    broken, gap, sound = made.close(3, 3)
    assert broken.item.raw == second[:9]
    assert hole(gap) == len(second) - 9 + 5
    assert sound.item == Frame(third)
    assert made.close(4, 4) == []


def test_bytes_that_the_other_end_has_are_missing_at_the_end() -> None:
    made = stream()
    made.receive(segment(0, FRAMES[0]), 1, 1)
    made.acknowledge(len(FRAMES[0]) + 500, 2, 2)
    (gap,) = made.close(3, 3)
    assert hole(gap) == 499  # the last may be a FIN


def test_a_forged_acknowledgement_is_not_believed() -> None:
    made = stream()
    made.acknowledge(ACK_LIMIT + 1, 2, 2)
    assert made.close(3, 3) == []


def test_fin_ends_a_stream_once_all_before_it_is_there() -> None:
    made = stream()
    first, second = FRAMES[:2]
    assert made.receive(segment(len(first), second, FIN | ACK), 1, 1) == []
    assert not made.closed
    assert raws(made.receive(segment(0, first), 2, 2)) == [first, second]
    assert made.closed
    assert made.receive(segment(0, first), 3, 3) == []


def test_fin_that_the_other_end_has_ends_a_stream_with_a_hole() -> None:
    made = stream()
    place = len(FRAMES[0])
    made.receive(segment(place, b"", FIN | ACK), 1, 1)
    (gap,) = made.acknowledge(place + 1, 2, 2)
    assert hole(gap) == place
    assert made.closed


def test_fin_of_a_frame_that_is_not_whole() -> None:
    made = stream()
    (broken,) = made.receive(segment(0, FRAMES[0][:-1], FIN | ACK), 1, 1)
    assert broken.item.raw == FRAMES[0][:-1]
    assert broken.item.problems


def test_what_is_sent_again_differently_is_counted_and_the_first_counts() -> None:
    made = stream()
    first, second, third, _ = FRAMES
    assert raws(made.receive(segment(0, first), 1, 1)) == [first]
    assert made.receive(segment(4, b"X" * 8), 2, 2) == []
    assert made.contradictions == 1
    start = len(first) + len(second)
    assert made.receive(segment(start, third), 3, 3) == []
    assert made.receive(segment(start - 2, second[-2:] + b"Y" * 8), 4, 4) == []
    assert made.contradictions == 2
    assert raws(made.receive(segment(len(first), second[:-2]), 5, 5)) == [second, third]


def test_keep_alive_probes_are_no_data() -> None:
    made = stream()
    made.receive(segment(0, FRAMES[0]), 1, 1)
    last = len(FRAMES[0]) - 1
    for probe in (b"", b"\x00"):
        assert made.receive(segment(last, probe), 2, 2) == []
    assert made.contradictions == 0
    assert raws(made.receive(segment(last + 1, FRAMES[1]), 3, 3)) == [FRAMES[1]]


def test_a_segment_that_the_capture_cut_leaves_a_hole() -> None:
    made = stream()
    first, second = FRAMES[:2]
    assert made.receive(segment(0, first[:20], missing=len(first) - 20), 1, 1) == []
    assert made.receive(segment(len(first), second), 2, 2) == []
    broken, gap, sound = made.acknowledge(len(first) + len(second), 3, 3)
    assert broken.item.raw == first[:20]
    assert hole(gap) == len(first) - 20
    assert sound.item == Frame(second)


def test_times_stay_bounded_in_a_frame_of_countless_segments() -> None:
    made = stream()
    long = request(1)[:1] + (MARKS_LIMIT * 3).to_bytes(4, "little") + request(1)[5:]
    argument = (MARKS_LIMIT * 3 - 20).to_bytes(4, "little") + b"\x11\x20"
    count = (MARKS_LIMIT * 3 - 26).to_bytes(4, "little")
    long = long[:13] + b"\x01\x00" + argument + count + bytes(MARKS_LIMIT * 3 - 26) + b"\x04"
    found: list[TimedItem] = []
    for place in range(len(long)):
        found += made.receive(segment(place, long[place : place + 1]), place, place)
    assert [(s.began, s.time, s.item.raw) for s in found] == [(0, len(long) - 1, long)]


def test_frames_inside_a_wrong_length_keep_about_their_times() -> None:
    made = stream()
    whole, released = [request(serial) for serial in range(1, 1001)], MARKS_LIMIT * 6
    wrong = whole[0][:1] + (released * len(whole[0]) + 1).to_bytes(4, "little") + whole[0][5:]
    found: list[TimedItem] = []
    for number, data in enumerate([wrong, *whole[1:]]):
        found += made.receive(segment(number * len(data), data), number, number)
    frames = [timed_item for timed_item in found if timed_item.item.raw in whole]
    assert len(frames) == 999
    for number, timed_item in enumerate(frames, 1):
        assert timed_item.packet == timed_item.time
        assert number <= timed_item.time <= number + max(released - number, 0) / 2 + 1


def test_bytes_outside_of_frames_have_the_times_of_their_own_segments() -> None:
    made = stream()
    for number, data in enumerate((b"garbage", b"more", FRAMES[0][:20]), 1):
        assert made.receive(segment(7 * (number > 1) + 4 * (number > 2), data), number, number) == []
    garbage, sound = made.receive(segment(31, FRAMES[0][20:]), 4, 4)
    assert (garbage.item.raw, garbage.began, garbage.time, garbage.packet) == (b"garbagemore", 1, 2, 2)
    assert (sound.item.raw, sound.began, sound.time, sound.packet) == (FRAMES[0], 3, 4, 4)


def both(*sent: tuple[int, TcpSegment]) -> tuple[TcpConnection, list[tuple[int, bytes]]]:
    connection = TcpConnection(ByteBudget())
    found = []
    for number, (sender, each) in enumerate(sent):
        found += connection.receive(sender, each, number, number)
    return connection, [(sender, timed_item.item.raw) for sender, timed_item in found]


def test_a_handshake_tells_the_server_and_where_streams_begin() -> None:
    connection, found = both(
        (0, TcpSegment(SYN, 2**32 - 1, 0, b"", 0)),
        (0, TcpSegment(SYN, 2**32 - 1, 0, b"", 0)),
        (1, TcpSegment(SYN | ACK, 99, 0, b"", 0)),
        (1, segment(100, FRAMES[1])),
        (0, segment(len(FRAMES[0]), FRAMES[2])),
        (0, segment(0, FRAMES[0])),
    )
    assert connection.server == 1
    assert found == [(1, FRAMES[1]), (0, FRAMES[0]), (0, FRAMES[2])]


def test_a_reset_ends_both_directions() -> None:
    connection, found = both(
        (0, segment(0, FRAMES[0][:9])), (1, segment(0, FRAMES[1][:9])), (0, segment(9, b"", RST))
    )
    assert found == [(0, FRAMES[0][:9]), (1, FRAMES[1][:9])]
    assert all(each.closed for each in connection.streams)


@pytest.mark.parametrize(
    ("sender", "next_segment", "follows"),
    [
        (0, TcpSegment(SYN, 10, 0, b"", 0), False),  # sent again
        (0, TcpSegment(SYN, 5000, 0, b"", 0), True),  # the ports are used again
        (1, TcpSegment(SYN | ACK, 20, 11, b"", 0), False),
        (1, TcpSegment(SYN | ACK, 7000, 11, b"", 0), True),
        (0, segment(11, FRAMES[0]), False),
        (0, segment(900, FRAMES[0]), False),
    ],
)
def test_a_new_connection_is_told_from_the_old(sender: int, next_segment: TcpSegment, follows: bool) -> None:
    connection, _ = both((0, TcpSegment(SYN, 10, 0, b"", 0)), (1, TcpSegment(SYN | ACK, 20, 11, b"", 0)))
    assert connection.is_reopened_by(sender, next_segment) is follows


def test_data_behind_the_end_is_of_another_connection() -> None:
    connection, _ = both((0, segment(0, FRAMES[0], FIN | ACK)))
    assert not connection.is_reopened_by(0, segment(0, FRAMES[0]))
    assert not connection.is_reopened_by(0, segment(len(FRAMES[0]) + 9, b""))
    assert connection.is_reopened_by(0, segment(len(FRAMES[0]) + 9, FRAMES[1]))


def test_a_handshake_after_a_stream_without_one_begins_anew() -> None:
    connection, _ = both((1, segment(500, FRAMES[1])))
    assert connection.is_reopened_by(0, TcpSegment(SYN, 10, 0, b"", 0))
    assert not connection.is_reopened_by(0, TcpSegment(SYN | ACK, 10, 0, b"", 0))


PIECES = st.sampled_from(
    [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (3, 4), (0, 0), (1, 1), (4, 4)]  # frames from and to
)
ODD_BYTES = st.sampled_from([0, 0, 0, 0, 3])
SEGMENTS = st.lists(
    st.tuples(
        st.integers(0, 1),
        PIECES,
        ODD_BYTES,
        st.integers(0, len(FRAMES)),
        st.sampled_from([ACK] * 9 + [0, SYN, SYN | ACK, FIN | ACK, RST]),
    ),
    max_size=12,
)
STARTS = [len(b"".join(FRAMES[:count])) for count in range(len(FRAMES) + 1)]


@given(SEGMENTS, st.sampled_from([0, 2**32 - 50]))
def test_the_short_way_gives_what_the_long_way_gives(
    drawn: list[tuple[int, tuple[int, int], int, int, int]], origin: int
) -> None:
    short, long = TcpConnection(ByteBudget()), TcpConnection(ByteBudget())
    for number, (sender, (first, last), odd, acked, flags) in enumerate(drawn):
        data = CONTENT[STARTS[first] : STARTS[last] + odd]
        made = segment(origin + STARTS[first], data, flags, origin + STARTS[acked])
        expected = long.receive(sender, made, number, number)
        said = short.receive_in_order(sender, made, number, number)
        if said is None:
            assert short.receive(sender, made, number, number) == expected
        else:
            assert [(sender, timed_item) for timed_item in said] == expected
    assert short.close(99, 99) == long.close(99, 99)
    counted = [[each.contradictions for each in made.streams] for made in (short, long)]
    assert counted[0] == counted[1]


def test_the_short_way_is_for_the_next_frame_of_a_connection_that_has_begun() -> None:
    connection = TcpConnection(ByteBudget())
    first = segment(0, FRAMES[0])
    assert connection.receive_in_order(0, first, 1, 1) is None
    connection.receive(0, first, 1, 1)
    second = segment(STARTS[1], FRAMES[1])
    assert connection.receive_in_order(0, second, 2, 2) == [TimedItem(2, 2, 2, Frame(FRAMES[1]))]
    assert connection.receive_in_order(0, segment(STARTS[2], b""), 3, 3) == []
    begun = segment(STARTS[2], FRAMES[2][:20])
    for other in (second, segment(STARTS[3], FRAMES[3]), begun):
        assert connection.receive_in_order(0, other, 4, 4) is None
    connection.receive(0, begun, 4, 4)
    connection.receive(0, segment(STARTS[2] + 20, FRAMES[2][20:]), 5, 5)
    third = segment(STARTS[3], FRAMES[3])
    assert connection.receive_in_order(0, third, 6, 6) == [TimedItem(6, 6, 6, Frame(FRAMES[3]))]
