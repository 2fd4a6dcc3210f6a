"""UDP conversations: bounds, and forged packets."""

from __future__ import annotations

import pytest

from bcapscope.capture import udp
from bcapscope.capture.counts import Counts
from bcapscope.capture.talk import Sighting
from bcapscope.capture.udp import Datagrams
from bcapscope.protocol.frame import Malformed, encode
from bcapscope.traffic.observation import Flow
from tests.capture.packets import CLIENT, SERVER, reply, request
from tests.capture.packets import udp as datagram

DOUBTFUL = encode(1, 0, 1)


def receive(
    datagrams: Datagrams, payload: bytes, sport: int, dport: int, addresses: bytes = CLIENT + SERVER
) -> list[tuple[Flow, Sighting]]:
    when = Sighting(0, 0, 1, Malformed(b"", ()))
    return datagrams.receive(addresses, datagram(payload, sport, dport), when, None)


def test_a_flow_is_known_by_the_bytes_of_its_addresses_and_ports() -> None:
    datagrams = Datagrams({5007}, Counts())
    ((flow, _),) = receive(datagrams, request(1), 50001, 5007)
    key = CLIENT + SERVER + (50001).to_bytes(2) + (5007).to_bytes(2)
    other = SERVER + CLIENT + (5007).to_bytes(2) + (50001).to_bytes(2)
    assert set(datagrams.flows) == {key, other}
    assert datagrams.flows[key] is flow
    assert datagrams.flows[other].conversation is flow.conversation


def test_flows_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "FLOWS_LIMIT", 10)
    datagrams = Datagrams({5007}, Counts())
    for port in range(1, 100):
        assert len(receive(datagrams, request(1), port, 5007)) == 1
        assert len(datagrams.flows) <= 10


def test_undecided_talks_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "TALKS_LIMIT", 10)
    datagrams = Datagrams({5007}, Counts())
    found = []
    for port in range(1, 100):
        found += receive(datagrams, DOUBTFUL, port, 6000)
    assert len(found) == 89
    found += datagrams.close()
    assert sorted(flow.src.port for flow, _ in found) == list(range(1, 100))
    assert datagrams.close() == []


def test_an_end_that_talks_to_itself_breaks_nothing() -> None:
    datagrams = Datagrams({5007}, Counts())
    assert receive(datagrams, DOUBTFUL, 5007, 5007, CLIENT + CLIENT) == []
    found = receive(datagrams, reply(1), 5007, 5007, CLIENT + CLIENT)
    assert [sighting.item.raw for _, sighting in found] == [DOUBTFUL, reply(1)]


def test_strangers_are_counted() -> None:
    counts = Counts()
    assert receive(Datagrams({5007}, counts), b"anything", 1, 2) == []
    assert counts.not_bcap == 1
