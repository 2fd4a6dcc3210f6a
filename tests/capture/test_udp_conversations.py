"""UDP conversations: bounds, and forged packets."""

from __future__ import annotations

import pytest

from bcapscope.capture import udp_conversations
from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.role_detection import TimedItem
from bcapscope.capture.udp_conversations import UdpConversations
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.traffic.observation import Flow
from tests.capture.packets import CLIENT, SERVER, reply, request
from tests.capture.packets import udp as datagram

DOUBTFUL = encode_frame(1, 0, 1)


def receive(
    datagrams: UdpConversations, payload: bytes, sport: int, dport: int, addresses: bytes = CLIENT + SERVER
) -> list[tuple[Flow, TimedItem]]:
    return datagrams.receive(addresses, datagram(payload, sport, dport), (0, 0, 1), None)


def test_a_flow_is_known_by_the_bytes_of_its_addresses_and_ports() -> None:
    datagrams = UdpConversations({5007}, CaptureCounts())
    ((flow, _),) = receive(datagrams, request(1), 50001, 5007)
    key = CLIENT + SERVER + (50001).to_bytes(2) + (5007).to_bytes(2)
    other = SERVER + CLIENT + (5007).to_bytes(2) + (50001).to_bytes(2)
    assert set(datagrams.flows) == {key, other}
    assert datagrams.flows[key] is flow
    assert datagrams.flows[other].conversation is flow.conversation


def test_flows_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp_conversations, "FLOWS_LIMIT", 10)
    datagrams = UdpConversations({5007}, CaptureCounts())
    for port in range(1, 100):
        assert len(receive(datagrams, request(1), port, 5007)) == 1
        assert len(datagrams.flows) <= 10


def test_undecided_talks_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp_conversations, "UNDECIDED_LIMIT", 10)
    datagrams = UdpConversations({5007}, CaptureCounts())
    found = []
    for port in range(1, 100):
        found += receive(datagrams, DOUBTFUL, port, 6000)
    assert len(found) == 89
    found += datagrams.close()
    assert sorted(flow.src.port for flow, _ in found) == list(range(1, 100))
    assert datagrams.close() == []


def test_an_end_that_talks_to_itself_breaks_nothing() -> None:
    datagrams = UdpConversations({5007}, CaptureCounts())
    assert receive(datagrams, DOUBTFUL, 5007, 5007, CLIENT + CLIENT) == []
    found = receive(datagrams, reply(1), 5007, 5007, CLIENT + CLIENT)
    assert [timed_item.item.raw for _, timed_item in found] == [DOUBTFUL, reply(1)]


def test_strangers_are_counted() -> None:
    counts = CaptureCounts()
    assert receive(UdpConversations({5007}, counts), b"anything", 1, 2) == []
    assert counts.not_bcap == 1


@pytest.mark.parametrize("rest", [request(2), b"\xee\xee"], ids=["frame", "junk"])
def test_a_frame_that_shares_its_datagram_has_a_problem(rest: bytes) -> None:
    datagrams = UdpConversations({5007}, CaptureCounts())
    (_, first), (_, second) = receive(datagrams, request(1) + rest, 50001, 5007)
    assert [problem.code for problem in first.item.problems] == ["length"]
    assert second.item.raw == rest
    ((_, alone),) = receive(datagrams, request(1), 50001, 5007)
    assert alone.item.problems == ()
