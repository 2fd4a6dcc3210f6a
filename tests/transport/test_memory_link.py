"""Loss, delay and duplication between two ends under virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from tests.memory_link import memory_link_pair
from tests.transport.receiver import Notes
from tests.virtual_time import run_in_virtual_time


def _by_first_byte(data: bytes) -> Iterable[float]:
    return {b"l": (), b"t": (0.1, 0.2), b"s": (0.5,)}.get(data[:1], (0.0,))


async def _heard(datagrams: bool) -> list[tuple[float, bytes | str]]:
    client, server = memory_link_pair(to_server=_by_first_byte, datagrams=datagrams)
    notes = server.receiver = Notes()
    for packet in (b"slow", b"lost", b"at once", b"twice"):
        client.send(packet)
    heard: list[tuple[float, bytes | str]] = []
    while len(heard) < 4:
        _, data = await notes.told.get()
        heard.append((asyncio.get_running_loop().time(), data))
    return heard


def test_packets_are_lost_late_and_doubled() -> None:
    heard = run_in_virtual_time(_heard(datagrams=True))
    assert heard == [(0.0, b"at once"), (0.1, b"twice"), (0.2, b"twice"), (0.5, b"slow")]


def test_a_stream_keeps_its_order() -> None:
    heard = run_in_virtual_time(_heard(datagrams=False))
    assert heard == [(0.5, b"slow"), (0.5, b"at once"), (0.5, b"twice"), (0.5, b"twice")]


def test_closing_one_end_of_a_stream_is_told_at_the_other() -> None:
    client, server = memory_link_pair(datagrams=False)
    notes, own = Notes(), Notes()
    server.receiver, client.receiver = notes, own
    client.close()
    client.close()
    server.send(b"late")
    assert notes.told.get_nowait() == ("lost", "the other end closed the connection")
    assert own.told.empty()


def test_closing_one_end_of_udp_is_not() -> None:
    client, server = memory_link_pair()
    notes = server.receiver = Notes()
    client.close()
    assert notes.told.empty()
