"""Relay and rules together, through real sockets."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bcapscope.faults import fault_injector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy import relay
from bcapscope.proxy.ring_buffer import RelayCounter, RingRecordKind
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.transport.socket_link import close_with_reset
from tests.english import decoded
from tests.faults.traffic import MS, reply, request
from tests.proxy.relaying import PATIENCE, Running, datagrams, eventually, listening, port_of, running
from tests.proxy.test_rule_policy import HALT, holding, rules


def live(*faults: str, expression: str = "") -> RulePolicy:
    """Make rules whose time is the relay's."""
    made = rules(clients=0, intercept=holding(expression) if expression else None)
    for fault in faults:
        made.shaper.add(read_fault(fault), time.monotonic_ns())
    return made


@contextmanager
def connected(policy: RulePolicy) -> Iterator[tuple[Running, socket.socket, socket.socket]]:
    """Connect a client to a server through a relay with rules; give the relay and both ends."""
    with (
        listening() as door,
        running(port_of(door), "tcp", policy=policy) as proxy,
        socket.create_connection(proxy.address, PATIENCE) as client,
    ):
        server, _ = door.accept()
        with server:
            server.settimeout(PATIENCE)
            yield proxy, client, server


def read_all(sock: socket.socket) -> bytes:
    """Read to the end."""
    with sock.makefile("rb") as stream:
        return stream.read()


def test_a_stream_cut_anyhow_comes_out_the_same() -> None:
    raw = b"".join(map(request, range(1, 200))) + b"garbage" + request(1)[:-5]
    with connected(live("drop if serial == 0")) as (proxy, client, server):
        for at in range(0, len(raw), 97):
            client.sendall(raw[at : at + 97])
        client.shutdown(socket.SHUT_WR)
        assert read_all(server) == raw
        assert proxy.relay.counts[RelayCounter.RULED] == 0


class Full(RulePolicy):
    """Holds too much while `is_so`."""

    is_so = True

    def is_full(self, client: int) -> bool:
        return self.is_so


def test_a_stream_is_read_on_as_soon_as_the_rules_have_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "SWEEP_EVERY", 1 << 40)  # what looks once a second does not help
    policy = Full(fault_injector.FaultInjector(now=0))
    with connected(policy) as (_, client, server):
        server.settimeout(0.2)
        client.sendall(request(1))
        with pytest.raises(TimeoutError):
            server.recv(1)
        server.settimeout(PATIENCE)
        policy.is_so = False
        assert server.recv(1000) == request(1)


def test_the_end_of_a_stream_waits_for_what_is_delayed() -> None:
    with connected(live("delay=150ms")) as (_, client, server):
        began = time.monotonic()
        client.sendall(request(1))
        client.shutdown(socket.SHUT_WR)
        assert read_all(server) == request(1)
        assert time.monotonic() - began >= 0.15


def test_a_held_stop_is_sent_when_the_proxy_ends() -> None:
    with connected(live("delay=60s")) as (proxy, client, server):
        client.sendall(request(1) + HALT)
        eventually(lambda: proxy.relay.counts[RelayCounter.RULED])
        proxy.stop()
        proxy.relay.release_all_held()
        proxy.relay.close()
        assert read_all(server) == HALT


def test_the_end_of_a_stream_passes_when_what_was_held_before_it_is_dropped() -> None:
    policy = live(expression="serial == 1")
    with connected(policy) as (proxy, client, server):
        client.sendall(request(1))
        client.shutdown(socket.SHUT_WR)
        eventually(lambda: [end for end in proxy.of(RingRecordKind.END) if end.received_at])
        (held,) = policy.intercept.held
        policy.drop_held(held.number, time.monotonic_ns())
        assert read_all(server) == b""
        eventually(
            lambda: (
                [(end.up, end.received_at) for end in proxy.of(RingRecordKind.END) if end.sent_at]
                == [(True, 0)]
            )
        )


def test_both_ends_wait_for_what_is_delayed_and_then_all_is_over() -> None:
    with connected(live("delay=100ms")) as (proxy, client, server):
        client.sendall(request(1))
        server.sendall(reply(1))
        client.shutdown(socket.SHUT_WR)
        server.shutdown(socket.SHUT_WR)
        assert read_all(server) == request(1)
        assert read_all(client) == reply(1)
        eventually(lambda: not proxy.relay.sessions)


def test_the_end_of_a_half_open_client_is_not_heard() -> None:
    with connected(live("half-open if serial == 2")) as (proxy, client, server):
        client.sendall(request(1) + request(2) + request(3))
        assert server.recv(4096) == request(1)
        eventually(lambda: proxy.relay.counts[RelayCounter.RULED])
        client.close()
        server.settimeout(0.3)
        with pytest.raises(TimeoutError):
            server.recv(1)
        server.sendall(reply(1))
        assert len(proxy.relay.sessions) == 1


@pytest.mark.parametrize("first", ["client", "server"])
@pytest.mark.parametrize("how", ["reset", "fin"])
def test_neither_end_of_a_half_open_conversation_hears_of_the_others(first: str, how: str) -> None:
    with connected(live("half-open if serial == 2")) as (proxy, client, server):
        client.sendall(request(1) + request(2))
        assert server.recv(4096) == request(1)
        eventually(lambda: proxy.relay.counts[RelayCounter.RULED])
        going, staying = (client, server) if first == "client" else (server, client)
        (session,) = proxy.relay.sessions.values()
        if how == "reset":
            close_with_reset(going)
            eventually(lambda: session.upstream_state == "half-open")
        else:
            going.close()
        staying.settimeout(0.3)
        with pytest.raises(TimeoutError):
            staying.recv(1)
        staying.sendall(request(3))
        assert list(proxy.relay.sessions.values()) == [session]
        staying.close()
        eventually(lambda: not proxy.relay.sessions)
        eventually(lambda: proxy.of(RingRecordKind.CLIENT_CLOSED))


def test_a_stop_that_is_held_is_sent_before_a_client_that_was_reset_is_let_go() -> None:
    halt = encode_frame(9, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))
    policy = live("delay=60s")
    with connected(policy) as (proxy, client, server):
        policy.notify = proxy.relay.notify
        client.sendall(request(1) + halt)
        eventually(lambda: proxy.relay.counts[RelayCounter.RULED])
        close_with_reset(client)
        assert read_all(server) == halt
        eventually(lambda: "not sent: 1 Robot_Execute slvMove" in proxy.notices())


def test_a_reset_by_a_rule_reaches_both_sides() -> None:
    with connected(live("close if serial == 2")) as (proxy, client, server):
        client.sendall(request(2))
        for end in (client, server):
            with pytest.raises(ConnectionResetError):
                end.recv(1)
        eventually(lambda: not proxy.relay.sessions)
        eventually(lambda: "close: connection reset" in proxy.notices())


def test_a_client_that_sends_more_than_is_held_is_not_read_and_loses_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fault_injector, "MAX_WAITING", 1 << 16)
    size = 8 << 20
    with connected(live("delay=1500ms")) as (proxy, client, server):
        sender = threading.Thread(target=client.sendall, args=(bytes(size),))
        sender.start()
        policy = proxy.relay.policy
        assert isinstance(policy, RulePolicy)
        eventually(lambda: policy.is_full(1), "filling")
        sender.join(0.2)
        assert sender.is_alive()
        policy.shaper.remove("delay")
        while size:
            size -= len(server.recv(1 << 20))
        sender.join(PATIENCE)
        assert not sender.is_alive()


def test_a_datagram_is_held_for_its_time_and_noted() -> None:
    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=live("delay=80ms±5ms request")) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        began = time.monotonic_ns()
        client.send(request(1))
        data, way = server.recvfrom(4096)
        took = time.monotonic_ns() - began
        assert data == request(1)
        assert took >= 75 * MS
        server.sendto(reply(1), way)
        assert client.recv(4096) == reply(1)
        eventually(lambda: len(proxy.passed(True)) == 2)
        came, left = (record for record in proxy.of(RingRecordKind.DATA) if record.up)
        assert decoded(came.note).startswith("delay: delayed by ")
        assert (came.sent_at, left.received_at, left.note) == (0, 0, came.note)


def test_a_held_datagram_goes_on_when_told() -> None:
    policy = live(expression="serial == 7")
    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=policy) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(request(7))
        client.send(request(8))
        assert Frame(server.recv(4096)).serial == 8
        (held,) = policy.intercept.held
        policy.forward_held(held.number, time.monotonic_ns())
        assert Frame(server.recv(4096)).serial == 7
