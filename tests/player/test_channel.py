"""Sockets and the clock of a thread that waits itself."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from bcapscope.player.channel import SPIN, SocketChannel, open_channel
from tests.transport.test_udp import two_addresses


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        yield sock


def closed_port() -> int:
    """Return a port where nobody listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
        return port


@pytest.mark.parametrize("length", [-SPIN, 0, SPIN // 2, 3 * SPIN])
def test_waiting_ends_on_time_and_not_before(length: int) -> None:
    channel = open_channel("127.0.0.1", closed_port(), tcp=False)
    until = channel.now() + length
    channel.wait(until)
    assert channel.now() >= until
    channel.close()


def test_a_name_with_an_address_of_ipv6_before_it_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", two_addresses)
    channel = open_channel("controller.test", 5007, tcp=False)
    assert channel.peer == ("127.0.0.1", 5007)
    channel.close()


def test_nothing_comes_until_the_time_is_over() -> None:
    channel = open_channel("127.0.0.1", closed_port(), tcp=False)
    until = channel.now() + 10 * SPIN
    assert channel.receive(until) is None
    assert channel.now() >= until
    assert channel.receive(0) is None
    channel.close()


def test_a_closed_udp_port_is_told_when_receiving_and_forgiven_when_sending() -> None:
    channel = open_channel("127.0.0.1", closed_port(), tcp=False)
    channel.send(b"one")
    channel.send(b"two")
    channel.send(b"three")
    with pytest.raises(ConnectionRefusedError):
        channel.receive(channel.now() + 10_000_000_000)
    channel.close()


def test_a_stream_that_ends_is_told(listening: socket.socket) -> None:
    host, port = listening.getsockname()
    channel = open_channel(host, port, tcp=True)
    server, _ = listening.accept()
    channel.send(b"abc")
    assert server.recv(10) == b"abc"
    server.sendall(b"def")
    assert channel.receive(channel.now() + 10_000_000_000) == b"def"
    server.close()
    with pytest.raises(ConnectionResetError, match="the peer closed the connection"):
        channel.receive(channel.now() + 10_000_000_000)
    channel.close()


def test_small_pieces_of_a_stream_are_not_held_back(listening: socket.socket) -> None:
    with socket.create_connection(listening.getsockname()) as sock:
        channel = SocketChannel(sock)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert (channel.datagrams, channel.peer) == (False, listening.getsockname())


def test_nobody_to_connect_to() -> None:
    with pytest.raises(ConnectionRefusedError):
        open_channel("127.0.0.1", closed_port(), tcp=True)
    with pytest.raises(OSError, match=r"not known|resolution"):
        open_channel("no.such.host.invalid", 5007, tcp=False)
