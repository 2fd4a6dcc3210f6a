"""Streams over real sockets: half-close, reset and back-pressure pass through."""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import pytest

from bcapscope.messages import Message
from bcapscope.messages.message_codec import encode_message
from bcapscope.proxy.poller import READ
from bcapscope.proxy.ring_buffer import RelayCounter, RingRecordKind
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.tcp_session import REPLY_TIMEOUT_NS, STUCK_AFTER_NS, TcpSession
from bcapscope.transport.descriptors import accept_connection
from tests.english import decoded
from tests.proxy.relaying import PATIENCE, Running, eventually, listening, port_of, running
from tests.proxy.test_rule_policy import rules

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


@contextmanager
def connected(policy: RulePolicy | None = None) -> Iterator[tuple[socket.socket, socket.socket, Running]]:
    """Connect a client to a server; yield both ends and the relay between them."""
    with (
        listening() as door,
        running(port_of(door), "tcp", policy=policy) as proxy,
        socket.create_connection(proxy.address, PATIENCE) as client,
    ):
        server, _ = door.accept()
        with server:
            server.settimeout(PATIENCE)
            yield client, server, proxy


def receive(sock: socket.socket, size: int) -> bytes:
    """Receive so many bytes, or up to the end."""
    data = b""
    while len(data) < size and (more := sock.recv(min(size - len(data), 1 << 20))):
        data += more
    return data


def cut(sock: socket.socket) -> None:
    """Close by RST."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    sock.close()


@contextmanager
def standing() -> Iterator[tuple[socket.socket, socket.socket, Running, TcpSession]]:
    """The same with a relay that has stopped, whose session does what the test has it do."""
    with connected() as (client, server, proxy):
        client.sendall(b"x")
        receive(server, 1)
        proxy.stop()
        (session,) = proxy.relay.sessions.values()
        assert isinstance(session, TcpSession)
        yield client, server, proxy, session


def test_bytes_pass_as_they_come_frames_or_not() -> None:
    with connected() as (client, server, proxy):
        for data in (b"\x01", b"\x00\x00", bytes(range(256))):
            client.sendall(data)
            assert receive(server, len(data)) == data
            server.sendall(data[::-1])
            assert receive(client, len(data)) == data[::-1]
        eventually(lambda: len(b"".join(proxy.passed(False))) == 259)
        assert b"".join(proxy.passed(True)) == b"\x01\x00\x00" + bytes(range(256))
        record = proxy.of(RingRecordKind.DATA)[0]
        assert 0 < record.received_at <= record.sent_at


def test_small_messages_are_sent_at_once_and_vanished_computers_are_noticed() -> None:
    with standing() as (_, _, _, session):
        for sock in (session._up.source, session._up.sink):
            assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)


def test_half_close_passes_through_and_the_other_half_goes_on() -> None:
    with connected() as (client, server, proxy):
        client.sendall(b"all I have")
        client.shutdown(socket.SHUT_WR)
        assert receive(server, 100) == b"all I have"
        server.sendall(b"and this is the answer")
        assert receive(client, 22) == b"and this is the answer"
        assert proxy.relay.sessions
        server.shutdown(socket.SHUT_WR)
        assert client.recv(1) == b""
        eventually(lambda: proxy.of(RingRecordKind.CLIENT_CLOSED))
        ends = [
            (record.up, bool(record.received_at), bool(record.sent_at))
            for record in proxy.of(RingRecordKind.END)
        ]
        assert ends == [(up, came, not came) for up in (True, False) for came in (True, False)]
        assert not proxy.of(RingRecordKind.RESET)
        assert proxy.of(RingRecordKind.CLIENT_CLOSED)[0].data == encode_message(Message("client.ended"))
        assert not proxy.relay.sessions


@pytest.mark.parametrize("up", [True, False])
def test_reset_passes_through(up: bool) -> None:
    with connected() as (client, server, proxy):
        client.sendall(b"x")
        receive(server, 1)
        first, second = (client, server) if up else (server, client)
        cut(first)
        with pytest.raises(ConnectionResetError):
            second.recv(1)
        eventually(lambda: proxy.of(RingRecordKind.CLIENT_CLOSED))
        who = "the client" if up else "the controller"
        reason = f"the connection to {who} failed: connection reset by peer"
        assert decoded(proxy.of(RingRecordKind.CLIENT_CLOSED)[0].data) == reason
        came, left = proxy.of(RingRecordKind.RESET)
        assert (came.up, bool(came.received_at), came.sent_at, came.data) == (up, True, 0, b"")
        assert (left.up, left.received_at, bool(left.sent_at), left.data) == (up, 0, True, b"")
        assert not proxy.of(RingRecordKind.END)


def test_who_does_not_read_is_not_written_to_without_end() -> None:
    data = bytes(range(256)) * 4096
    with connected() as (client, server, proxy):
        client.setblocking(False)
        sent = 0
        quiet = 0
        while quiet < 20:  # the buffers of the system and one read of the relay are full
            try:
                sent += client.send(data)
                quiet = 0
            except BlockingIOError:
                quiet += 1
                threading.Event().wait(0.01)
            assert sent < 64 << 20
        (session,) = proxy.relay.sessions.values()
        assert 0 < len(session._up.pending) <= 1 << 16  # type: ignore[attr-defined]
        assert proxy.relay.counts[RelayCounter.BYTES_UP] < sent
        server.sendall(b"the other way is free")
        client.settimeout(PATIENCE)
        assert receive(client, 21) == b"the other way is free"
        received = 0
        while received < sent:
            received += len(server.recv(1 << 20))
        client.sendall(b"!")
        assert server.recv(10) == b"!"
        eventually(lambda: proxy.relay.counts[RelayCounter.BYTES_UP] == sent + 1)


class SlowSocket(socket.socket):
    """Takes 1000 bytes, then 1, then none, and so on."""

    calls = 0

    def send(self, data: ReadableBuffer, flags: int = 0, /) -> int:
        self.calls += 1
        if self.calls % 3 == 0:
            raise BlockingIOError
        return super().send(memoryview(data)[: 1000 if self.calls % 3 == 1 else 1], flags)


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("ruled", [True, False])
def test_each_byte_is_recorded_when_it_came_and_when_it_left(
    monkeypatch: pytest.MonkeyPatch, up: bool, ruled: bool
) -> None:
    monkeypatch.setattr("bcapscope.proxy.tcp_session.socket.socket", SlowSocket)
    data = b"".join(number.to_bytes(4, "big") for number in range(2500))
    with connected(rules(clients=0) if ruled else None) as (client, server, proxy):
        source, sink = (client, server) if up else (server, client)
        passed = b""
        for size in (1, 999, 1000, 1001, 9999, 10_000):
            source.sendall(data[:size])
            assert receive(sink, size) == data[:size]
            passed += data[:size]
        eventually(lambda: recorded_bytes(proxy, "sent_at") == passed)
        assert recorded_bytes(proxy, "received_at") == passed
        assert {each.up for each in proxy.of(RingRecordKind.DATA)} == {up}
        assert proxy.relay.counts[RelayCounter.BYTES_UP if up else RelayCounter.BYTES_DOWN] == len(passed)


def recorded_bytes(proxy: Running, time: str) -> bytes:
    """Return the bytes of all records that carry this time, `received_at` or `sent_at`."""
    return b"".join(record.data for record in proxy.of(RingRecordKind.DATA) if getattr(record, time))


def test_a_reset_while_nothing_is_read_is_noticed() -> None:
    with connected() as (client, server, proxy):
        client.setblocking(False)
        quiet = 0
        while quiet < 20:
            try:
                client.send(bytes(1 << 20))
                quiet = 0
            except BlockingIOError:
                quiet += 1
                threading.Event().wait(0.01)
        cut(client)
        eventually(lambda: not proxy.relay.sessions)
        with pytest.raises(ConnectionResetError):
            receive(server, 1 << 40)


def test_an_unreachable_controller_is_told_and_the_client_is_cut_off() -> None:
    with listening() as door:
        port = port_of(door)
    with running(port, "tcp") as proxy:
        with pytest.raises(ConnectionResetError), socket.create_connection(proxy.address, PATIENCE) as client:
            client.recv(1)
        eventually(proxy.notices)
        assert f"no connection to 127.0.0.1:{port} over TCP: connection refused" in proxy.notices()


def test_a_controller_to_which_no_connection_can_begin_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket.socket, "connect_ex", lambda sock, address: errno.ENETUNREACH)
    with listening() as door, running(port_of(door), "tcp") as proxy:
        with pytest.raises(ConnectionResetError), socket.create_connection(proxy.address, PATIENCE) as client:
            client.recv(1)
        eventually(proxy.notices)
        assert os.strerror(errno.ENETUNREACH).lower() in proxy.notices()


def test_without_file_descriptors_clients_are_cut_off_and_taken_again_when_there_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with listening() as door, running(port_of(door), "tcp") as proxy:
        kind = socket.socket

        def none_left(family: int, type: int, proto: int = 0, fileno: int | None = None) -> socket.socket:
            if fileno is None:  # it is not one that was taken already
                raise OSError(errno.EMFILE, "")
            return kind(family, type, proto, fileno)

        with kind(socket.AF_INET, socket.SOCK_STREAM) as client:
            monkeypatch.setattr("bcapscope.proxy.tcp_listener.socket.socket", none_left)
            client.settimeout(PATIENCE)

            def knock() -> None:
                """Be cut off, which may be known before the connection is."""
                client.connect(proxy.address)
                client.recv(1)

            with pytest.raises(ConnectionResetError):
                knock()
            monkeypatch.undo()
        eventually(
            lambda: "cannot be accepted: too many open files; its connection is closed" in proxy.notices()
        )
        with socket.create_connection(proxy.address, PATIENCE):
            door.accept()[0].close()


def test_a_listener_that_accepts_nobody_says_so_once_until_it_accepts_a_client(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refusals = [True, True, False, True]  # the listener looks for a second client at once

    def accept(listener: socket.socket, free: Callable[[], bool]) -> tuple[socket.socket, object] | None:
        if refusals and refusals.pop(0):
            raise OSError(errno.EMFILE, "")
        return accept_connection(listener, free)

    monkeypatch.setattr("bcapscope.proxy.tcp_listener.accept_connection", accept)
    with listening() as door, running(port_of(door), "tcp") as proxy:
        with socket.create_connection(proxy.address, PATIENCE):
            door.accept()[0].close()
        eventually(lambda: not refusals)
        with socket.create_connection(proxy.address, PATIENCE):
            door.accept()[0].close()
        proxy.stop()
        eventually(proxy.notices)
        assert proxy.notices().count("cannot accept clients on") == 2


@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep more connections waiting")
def test_a_controller_that_does_not_answer_for_10_s_is_given_up() -> None:
    with ExitStack() as stack, socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        door.listen(0)
        for _ in range(3):  # the system accepts no further connection, and does not refuse it either
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(door.getsockname())
        proxy = stack.enter_context(running(port_of(door), "tcp"))
        client = stack.enter_context(socket.create_connection(proxy.address, PATIENCE))
        eventually(lambda: proxy.relay.sessions)
        (session,) = proxy.relay.sessions.values()
        proxy.stop()
        assert session.upstream_state == "connecting"
        session.sweep(session.last_heard + 10_000_000_000)
        assert proxy.relay.sessions
        session.sweep(session.last_heard + 10_000_000_001)
        assert not proxy.relay.sessions
        eventually(lambda: "timed out" in proxy.notices())
        with pytest.raises(ConnectionResetError):
            client.recv(1)


def test_the_state_of_a_connection_is_known() -> None:
    with connected() as (_client, _server, proxy):
        eventually(lambda: [each.upstream_state for each in proxy.relay.sessions.values()] == ["connected"])


def test_who_ended_its_side_may_wait_for_a_reply_as_long_as_a_call_takes() -> None:
    with standing() as (client, server, proxy, session):
        client.shutdown(socket.SHUT_WR)
        wait_for(session._up.source, select.POLLIN)
        session._on_client_ready(READ)
        session.sweep(proxy.relay.now + REPLY_TIMEOUT_NS)
        assert session.evictable_idle_ns(proxy.relay.now + STUCK_AFTER_NS) is None
        server.sendall(b"the reply")
        wait_for(session._down.source, select.POLLIN)
        session._on_controller_ready(READ)
        assert receive(client, 9) == b"the reply"
        assert session.evictable_idle_ns(proxy.relay.now + 1_000_000_000) is None
        assert session.evictable_idle_ns(proxy.relay.now + 1_000_000_001) == 1_000_000_001
        session.sweep(proxy.relay.now + REPLY_TIMEOUT_NS)
        assert proxy.relay.sessions
        session.sweep(proxy.relay.now + REPLY_TIMEOUT_NS + 1)
        assert not proxy.relay.sessions
        assert server.recv(1) == b""
        assert not proxy.of(RingRecordKind.RESET)


def test_a_client_that_stays_when_the_controller_has_gone_is_ended() -> None:
    with standing() as (client, server, proxy, session):
        assert session.evictable_idle_ns(proxy.relay.now + 10 * STUCK_AFTER_NS) is None
        server.close()
        wait_for(session._down.source, select.POLLIN)
        session._on_controller_ready(READ)
        assert client.recv(1) == b""
        session.sweep(proxy.relay.now + STUCK_AFTER_NS)
        assert session.evictable_idle_ns(proxy.relay.now + STUCK_AFTER_NS) is None
        assert session.evictable_idle_ns(proxy.relay.now + STUCK_AFTER_NS + 1) == STUCK_AFTER_NS + 1
        assert proxy.relay.sessions
        session.sweep(proxy.relay.now + STUCK_AFTER_NS + 1)
        assert not proxy.relay.sessions


def test_a_client_that_does_not_read_gives_way_and_one_that_only_says_nothing_does_not() -> None:
    with standing() as (_, _, proxy, session):
        assert session.evictable_idle_ns(proxy.relay.now + REPLY_TIMEOUT_NS) is None
        session.send(False, bytes(64 << 20))
        assert session.evictable_idle_ns(session.last_heard + STUCK_AFTER_NS) is None
        quiet = session.evictable_idle_ns(proxy.relay.now + STUCK_AFTER_NS + 1)
        assert quiet is not None
        assert quiet > STUCK_AFTER_NS
        session.sweep(proxy.relay.now + 10 * REPLY_TIMEOUT_NS)
        assert proxy.relay.sessions


def wait_for(sock: socket.socket, sign: int) -> None:
    """Wait until the system tells something of a socket."""
    poll = select.poll()
    poll.register(sock, sign)
    assert poll.poll(PATIENCE * 1000)


def test_what_is_sent_last_is_told() -> None:
    with standing() as (_, server, proxy, session):
        session._up.pending += b"the last"
        session.close(False, Message("client.proxy-ended"))
        assert receive(server, 99) == b"the last"
        proxy.relay.close()
        sent = [each for each in (*proxy.look(), *proxy.look()) if each.data == b"the last"]
        assert [(each.kind, each.up, each.received_at, each.sent_at > 0) for each in sent] == [
            (RingRecordKind.DATA, True, 0, True)
        ]


@pytest.mark.parametrize("up", [True, False])
def test_what_is_not_taken_at_the_end_is_told(monkeypatch: pytest.MonkeyPatch, up: bool) -> None:
    with standing() as (_, _, proxy, session):
        monkeypatch.setattr(socket.socket, "send", lambda sock, data, flags=0: 3)
        (session._up if up else session._down).pending += b"the last"
        session.close(False, Message("client.proxy-ended"))
        proxy.relay.close()
        whose = "the controller" if up else "the client"
        proxy.look()
        assert f"5 bytes could not be delivered to {whose}" in proxy.notices()
        assert [each.data for each in proxy.of(RingRecordKind.DATA) if each.up is up][-1] == b"the"


@pytest.mark.parametrize("by_reset", [True, False])
def test_both_directions_are_noted_as_ended_by_the_relay_once(by_reset: bool) -> None:
    with standing() as (client, server, proxy, session):
        session._up.pending += b"the last"
        session.close(by_reset, Message("client.ended"))
        proxy.relay.close()
        proxy.look()
        kind, other = (
            (RingRecordKind.RESET, RingRecordKind.END)
            if by_reset
            else (RingRecordKind.END, RingRecordKind.RESET)
        )
        ends = [(each.up, each.received_at, each.sent_at > 0, decoded(each.data)) for each in proxy.of(kind)]
        assert ends == [(True, 0, True, "ended by both sides"), (False, 0, True, "ended by both sides")]
        assert not proxy.of(other)
        assert session.send(True, b"too late") == 0
        if by_reset:  # nothing of what was pending is sent before it
            for sock in (client, server):
                with pytest.raises(ConnectionResetError):
                    sock.recv(10)
        else:
            assert receive(server, 99) == b"the last"
            assert client.recv(10) == b""


def test_what_came_and_could_not_be_passed_on_any_more_is_told_before_its_client_is_forgotten() -> None:
    with standing() as (client, server, proxy, session):
        client.sendall(b"the last")
        cut(server)
        for end, sign in ((session._down.source, select.POLLERR), (session._up.source, select.POLLIN)):
            wait_for(end, sign)
        session._on_client_ready(READ)
        assert not proxy.relay.sessions
        proxy.relay.close()
        kinds = [(record.kind, record.data) for record in (*proxy.look(), *proxy.look())]
        assert kinds.index((RingRecordKind.DATA, b"the last")) < len(kinds) - 1
        assert kinds[-1][0] is RingRecordKind.CLIENT_CLOSED


def test_strangers_are_cut_off() -> None:
    with listening() as door, running(port_of(door), "tcp", allow=["10.0.0.1"]) as proxy:
        with pytest.raises(ConnectionResetError), socket.create_connection(proxy.address, PATIENCE) as client:
            client.recv(1)
        eventually(lambda: "is not allowed" in proxy.notices())
        assert proxy.relay.counts[RelayCounter.DENIED] == 1


def test_connections_that_come_and_go_leave_nothing() -> None:
    with listening() as door, running(port_of(door), "tcp") as proxy:
        for number in range(50):
            with socket.create_connection(proxy.address, PATIENCE) as client:
                server, _ = door.accept()
                with server:
                    client.sendall(b"hello")
                    assert receive(server, 5) == b"hello"
                    if number % 2:
                        cut(client)
        eventually(lambda: not proxy.relay.sessions)
        assert len(proxy.relay._handlers) == 2  # the port and the ticker
