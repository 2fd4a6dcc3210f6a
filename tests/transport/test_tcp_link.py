"""Real connections on loopback."""

from __future__ import annotations

import asyncio
import socket

import pytest

from bcapscope.transport.socket_link import open_tcp
from tests.transport.receiver import Notes


def _listener() -> socket.socket:
    return socket.create_server(("127.0.0.1", 0))


def test_bytes_go_both_ways_until_the_peer_closes() -> None:
    async def talk() -> None:
        with _listener() as server:
            notes = Notes()
            link = await open_tcp("127.0.0.1", server.getsockname()[1], notes)
            peer, address = server.accept()
            with peer:
                assert not link.datagrams
                assert (link.local, link.peer) == (address, server.getsockname())
                link.send(b"one")
                assert peer.recv(99) == b"one"
                peer.sendall(b"two")
                assert await notes.told.get() == ("received", b"two")
            assert await notes.told.get() == ("lost", "the other end closed the connection")
            link.send(b"nobody reads that")
            link.close()

    asyncio.run(talk())


def test_after_closing_nothing_is_told() -> None:
    async def talk() -> None:
        with _listener() as server:
            notes = Notes()
            link = await open_tcp("127.0.0.1", server.getsockname()[1], notes)
            link.close()
            with server.accept()[0] as peer:
                assert await asyncio.to_thread(peer.recv, 1) == b""
            assert notes.told.empty()

    asyncio.run(talk())


def test_nobody_listens() -> None:
    with _listener() as server:
        port = server.getsockname()[1]
    with pytest.raises(ConnectionRefusedError):
        asyncio.run(open_tcp("127.0.0.1", port, Notes()))
