"""A real socket on loopback."""

from __future__ import annotations

import asyncio
import socket

import pytest

from bcapscope.transport.socket_link import AddressInfo, open_udp, preferred_address
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


def two_addresses(name: str, port: int, **_: object) -> list[AddressInfo]:
    """Find what localhost has on many systems."""
    return [
        (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", port, 0, 0)),
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", port)),
    ]


def test_of_two_addresses_that_of_ipv4_is_tried() -> None:
    six, four = two_addresses("localhost", 5007)
    assert preferred_address([six, four]) is preferred_address([four, six]) is four
    assert preferred_address([six]) is six


def test_a_name_with_an_address_of_ipv6_before_it_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    async def talk() -> None:
        found = socket.getaddrinfo

        def find(host: str, port: int, family: int = 0, *rest: int, **more: int) -> object:
            if host != "controller.test":
                return found(host, port, family, *rest, **more)
            return [each for each in two_addresses(host, port) if family in (0, each[0])]

        monkeypatch.setattr(socket, "getaddrinfo", find)
        link = await open_udp("controller.test", 5007, Notes())
        assert link.peer == ("127.0.0.1", 5007)
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
