"""TCP conversations: bounds, and forged packets."""

from __future__ import annotations

import pytest

from bcapscope.capture import tcp_conversations
from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.role_detection import TimedItem, reverse_key
from bcapscope.capture.tcp_conversations import TcpConversations
from bcapscope.capture.tcp_reassembly import ACK, FIN, RST, SYN, TcpSegment
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.traffic.observation import ConnectionEnd, Direction, Flow
from tests.capture.packets import CLIENT, SERVER, reply, request

DOUBTFUL = encode_frame(1, 0, 1)


def receive(
    calls: TcpConversations, data: bytes, sport: int, dport: int = 5007, *, flags: int = ACK, seq: int = 1
) -> list[tuple[Flow, TimedItem]]:
    key = CLIENT + SERVER + sport.to_bytes(2) + dport.to_bytes(2)
    return calls.receive(key, TcpSegment(flags, seq, 0, data, 0), sport, sport)


def test_the_connection_that_was_silent_longest_is_ended_beyond_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tcp_conversations, "CONNECTIONS_LIMIT", 3)
    calls = TcpConversations({5007}, CaptureCounts())
    frame = request(1)
    for port in (1, 2, 3):
        assert receive(calls, frame[:9], port) == []
    assert len(receive(calls, frame[9:], 1, seq=10)) == 1
    ((flow, timed_item),) = receive(calls, frame, 4)[:1]
    assert flow.src.port == 2
    assert timed_item.item.raw == frame[:9]
    assert [flow.src.port for flow, _ in calls.close(0, 0)] == [3]


def test_a_flood_of_handshakes_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp_conversations, "CONNECTIONS_LIMIT", 3)
    calls = TcpConversations({5007}, CaptureCounts())
    for port in range(1, 1000):
        assert receive(calls, b"", port, flags=SYN) == []
    assert calls.close(0, 0) == []


def test_an_end_that_talks_to_itself_breaks_nothing() -> None:
    calls = TcpConversations({5007}, CaptureCounts())
    key = CLIENT + CLIENT + bytes((19, 143)) * 2
    assert calls.receive(key, TcpSegment(ACK, 1, 1, DOUBTFUL, 0), 1, 1) == []
    found = calls.receive(key, TcpSegment(ACK, 17, 17, reply(1), 0), 2, 2)
    assert [timed_item.item.raw for _, timed_item in found] == [DOUBTFUL, reply(1)]
    assert calls.close(3, 3) == []


@pytest.mark.parametrize(
    ("flags", "closing"),
    [
        ((FIN | ACK, RST), ConnectionEnd(Direction.REQUEST, False, 2, both_ended=True)),
        ((FIN | ACK, FIN | ACK), ConnectionEnd(Direction.REQUEST, False, 2, both_ended=True)),
        ((FIN | ACK, ACK), ConnectionEnd(Direction.REQUEST, False, 2)),
        ((RST, FIN | ACK), ConnectionEnd(Direction.REQUEST, True, 2, both_ended=True)),
        ((ACK, RST), ConnectionEnd(Direction.RESPONSE, True, 3)),
        ((ACK, ACK), None),
    ],
)
def test_who_ended_a_connection_first_is_known(flags: tuple[int, int], closing: ConnectionEnd | None) -> None:
    calls = TcpConversations({5007}, CaptureCounts())
    ((flow, _),) = receive(calls, request(1), 1)
    assert flow.conversation.connection_end is None
    for time, each in enumerate(flags, 2):
        key = CLIENT + SERVER + (1).to_bytes(2) + (5007).to_bytes(2)
        segment = TcpSegment(each, 1 + len(request(1)), 1, b"", 0)
        calls.receive(key if time == 2 else reverse_key(key), segment, time, time)
    assert flow.conversation.connection_end == closing


def test_who_ended_a_connection_is_told_once_it_is_known_which_end_is_the_server() -> None:
    calls = TcpConversations({5007, 5008}, CaptureCounts())
    assert receive(calls, DOUBTFUL, 5008) == []
    assert receive(calls, b"", 5008, flags=FIN | ACK, seq=17) == []
    ((flow, _),) = calls.close(9, 9)
    assert flow.conversation.connection_end == ConnectionEnd(flow.direction, False, 5008)


def test_both_ends_on_the_port_are_told_by_what_is_said() -> None:
    calls = TcpConversations({5007, 5008}, CaptureCounts())
    assert receive(calls, DOUBTFUL, 5008) == []
    ((flow, _), _) = receive(calls, request(1), 5008, seq=17)
    assert flow.conversation.server.port == 5007


def test_a_frame_that_never_ends_on_an_unknown_port_is_no_bcap() -> None:
    counts = CaptureCounts()
    calls = TcpConversations({5007}, counts)
    assert receive(calls, b"", 1, 2, flags=SYN, seq=0) == []
    assert receive(calls, b"\x01", 1, 2) == []
    assert receive(calls, b"", 1, 2, flags=FIN, seq=2) == []
    assert calls.close(0, 0) == []
    assert counts.not_bcap == 1


def test_what_was_no_bcap_may_become_it() -> None:
    counts = CaptureCounts()
    calls = TcpConversations({5007}, counts)
    assert receive(calls, b"HELLO", 1, 2) == []
    assert receive(calls, b"\x01\x40", 1, 2, seq=6) == []
    ((flow, timed_item),) = receive(calls, request(1), 1, 2, seq=8)
    assert (flow.conversation.server.port, timed_item.item.raw) == (2, request(1))
    assert counts.not_bcap == 2


def test_an_acknowledgement_out_of_nowhere_begins_nothing() -> None:
    counts = CaptureCounts()
    calls = TcpConversations({5007}, counts)
    assert receive(calls, b"", 1) == []
    assert calls.close(0, 0) == []
    assert counts.not_bcap == 0
