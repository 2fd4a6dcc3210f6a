"""Sockets and the clock of a thread that waits itself."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

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


TOLD = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells when something came")


@contextmanager
def ends(tcp: bool) -> Iterator[tuple[SocketChannel, socket.socket]]:
    """Yield a channel, and a socket at its other end that has said hello."""
    kind = socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM
    with socket.socket(socket.AF_INET, kind) as there:
        there.bind(("127.0.0.1", 0))
        if tcp:
            there.listen()
        host, port = there.getsockname()
        channel = open_channel(host, port, tcp)
        peer = there.accept()[0] if tcp else there
        if not tcp:
            peer.connect(channel.local)
        peer.send(b"hello")
        assert channel.receive(channel.now() + 10_000_000_000) == b"hello"
        try:
            yield channel, peer
        finally:
            channel.close()
            if tcp:
                peer.close()


@TOLD
@pytest.mark.parametrize("tcp", [False, True], ids=["udp", "tcp"])
def test_it_is_told_when_something_came_however_late_it_is_read(tcp: bool) -> None:
    with ends(tcp) as (channel, peer):

        def is_told() -> bool:
            before = channel.now()
            peer.send(b"abc")
            rested = channel.now() + 20_000_000
            channel.rest(rested)
            assert channel.now() >= rested  # what came meanwhile woke nobody
            assert channel.receive(rested + 10_000_000_000) == b"abc"
            assert channel.arrived >= before - 100_000
            return channel.arrived < rested

        assert any(is_told() for _ in range(5))  # unless each time we are held up while looking at the clocks


@TOLD
@pytest.mark.parametrize("step", [-10_000_000, 10_000_000])
def test_after_a_clock_was_set_what_was_read_counts_as_come(
    monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    with ends(tcp=False) as (channel, peer):
        plain = time.time_ns
        monkeypatch.setattr(time, "time_ns", lambda: plain() + step)
        for _ in range(2):  # the second finds that the system tells by a clock that is not ours
            peer.send(b"abc")
            before = channel.now()
            assert channel.receive(before + 10_000_000_000) == b"abc"
            monkeypatch.setattr(time, "time_ns", plain)
            assert before <= channel.arrived <= channel.now()


def test_nobody_rests_where_nobody_tells_when_something_came(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.player.channel.ask_for_times", lambda sock: None)
    with ends(tcp=False) as (channel, _):
        until = channel.now() + 3_600_000_000_000
        channel.rest(until)
        assert channel.now() < until


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
