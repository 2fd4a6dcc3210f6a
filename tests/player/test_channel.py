"""Sockets and the clock of a thread that waits itself."""

from __future__ import annotations

import errno
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bcapscope.player import blocking_caller as channels
from bcapscope.player.blocking_caller import SPIN_TIME, Channel, open_channel
from bcapscope.transport.receive_timestamps import kernel_timestamp
from tests.transport.test_udp_link import two_addresses


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


@pytest.mark.parametrize("length", [-SPIN_TIME, 0, SPIN_TIME // 2, 3 * SPIN_TIME])
def test_waiting_ends_on_time_and_not_before(length: int) -> None:
    channel = open_channel("127.0.0.1", closed_port(), tcp=False)
    until = channel.now() + length
    channel.wait_until(until)
    assert channel.now() >= until
    channel.close()


def test_a_name_with_an_address_of_ipv6_before_it_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", two_addresses)
    channel = open_channel("controller.test", 5007, tcp=False)
    assert channel.peer == ("127.0.0.1", 5007)
    channel.close()


def test_a_connection_that_is_reset_at_once_is_closed(
    listening: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: socket.socket) -> None:
        raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")

    monkeypatch.setattr(channels, "enable_receive_timestamps", refuse)
    with pytest.raises(OSError, match="not connected"):
        open_channel("127.0.0.1", listening.getsockname()[1], tcp=True)
    accepted, _ = listening.accept()
    with accepted:
        accepted.settimeout(10)
        assert accepted.recv(1) == b""


def test_nothing_comes_until_the_time_is_over() -> None:
    channel = open_channel("127.0.0.1", closed_port(), tcp=False)
    until = channel.now() + 10 * SPIN_TIME
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
    with pytest.raises(ConnectionResetError, match="the other end closed the connection"):
        channel.receive(channel.now() + 10_000_000_000)
    channel.close()


TOLD = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells when something came")


@contextmanager
def ends(tcp: bool) -> Iterator[tuple[Channel, socket.socket]]:
    """Yield a channel, and a socket at its other end that has said hello."""
    kind = socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM
    with socket.socket(socket.AF_INET, kind) as there:
        there.bind(("127.0.0.1", 0))
        if tcp:
            there.listen()
        host, port = there.getsockname()
        channel = open_channel(host, port, tcp)
        peer = there.accept()[0] if tcp else there
        if tcp:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            peer.connect(channel.local)
        for _ in range(100):  # until the system tells, if it does: with the first one it only begins to
            peer.send(b"hello")
            assert channel.receive(channel.now() + 10_000_000_000) == b"hello"
            until = channel.now() + 1_000_000
            channel.sleep_until(until)
            if channel.now() >= until:
                break
        try:
            yield channel, peer
        finally:
            channel.close()
            if tcp:
                peer.close()


def is_told(channel: Channel, peer: socket.socket) -> bool:
    """Send something, rest, and read it; return whether it is told when it came."""
    before = channel.now()
    peer.send(b"abc")
    rested = channel.now() + 20_000_000
    channel.sleep_until(rested)
    assert channel.now() >= rested  # what came meanwhile woke nobody
    assert channel.receive(rested + 10_000_000_000) == b"abc"
    assert before - 100_000 <= channel.arrival_time <= channel.now()
    return channel.arrival_time < rested


@TOLD
@pytest.mark.parametrize("tcp", [False, True], ids=["udp", "tcp"])
def test_it_is_told_when_something_came_however_late_it_is_read(tcp: bool) -> None:
    with ends(tcp) as (channel, peer):
        assert any(is_told(channel, peer) for _ in range(5))  # unless each time we are held up in between


@TOLD
@pytest.mark.parametrize("step", [-500_000_000, -10_000_000, 3_000_000, 3_600_000_000_000])
def test_a_clock_that_is_set_moves_nothing(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    with ends(tcp=False) as (channel, peer):
        time_ns = time.time_ns
        monkeypatch.setattr(time, "time_ns", lambda: time_ns() + step)
        monkeypatch.setattr(
            "bcapscope.player.blocking_caller.kernel_timestamp",
            lambda control, now: kernel_timestamp(control, now) + step,
        )
        assert not is_told(channel, peer)
        assert any(is_told(channel, peer) for _ in range(5))


def test_nobody_rests_where_nobody_tells_when_something_came(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.player.blocking_caller.enable_receive_timestamps", lambda sock: None)
    with ends(tcp=False) as (channel, _):
        until = channel.now() + 3_600_000_000_000
        channel.sleep_until(until)
        assert channel.now() < until


def test_small_pieces_of_a_stream_are_not_held_back(listening: socket.socket) -> None:
    with socket.create_connection(listening.getsockname()) as sock:
        channel = Channel(sock)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert (channel.datagrams, channel.peer) == (False, listening.getsockname())


def test_nobody_to_connect_to() -> None:
    with pytest.raises(ConnectionRefusedError):
        open_channel("127.0.0.1", closed_port(), tcp=True)
    with pytest.raises(OSError, match=r"not known|resolution"):
        open_channel("no.such.host.invalid", 5007, tcp=False)
