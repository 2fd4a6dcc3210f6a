"""A real socket on loopback."""

from __future__ import annotations

import asyncio
import socket

from bcapscope.transport.udp import open_udp
from tests.transport.receiver import Notes


def test_datagrams_go_both_ways() -> None:
    async def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
            server.bind(("127.0.0.1", 0))
            notes = Notes()
            link = await open_udp("127.0.0.1", server.getsockname()[1], notes)
            assert link.datagrams
            assert link.peer == server.getsockname()
            link.send(b"one")
            assert server.recvfrom(99) == (b"one", link.local)
            server.sendto(b"two", link.local)
            assert await notes.told.get() == ("received", b"two")
            link.close()
            link.close()

    asyncio.run(talk())


def test_a_closed_port_is_told_and_the_link_stays() -> None:
    async def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
            server.bind(("127.0.0.1", 0))
            port = server.getsockname()[1]
        notes = Notes()
        link = await open_udp("127.0.0.1", port, notes)
        link.send(b"one")
        assert await notes.told.get() == ("trouble", "connection refused")
        link.close()
        await asyncio.sleep(0)
        assert notes.told.empty()

    asyncio.run(talk())
