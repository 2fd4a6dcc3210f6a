"""Datagrams over real sockets: who speaks to whom, what is refused, what is forgotten."""

from __future__ import annotations

import errno
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import pytest

from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy import relay as relay_module
from bcapscope.proxy import udp_listener
from bcapscope.proxy.admission import MAX_CLIENTS, MAX_PER_SOURCE
from bcapscope.proxy.listener_spec import parse_listener_specs
from bcapscope.proxy.listeners import open_listeners
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring_buffer import RING_OVERHEAD, RelayCounter, RingReader, RingRecordKind, RingWriter
from bcapscope.proxy.sockets import connect_datagrams, listen_on, local_address_for
from bcapscope.traffic.observation import Endpoint, Transport
from tests.english import decoded
from tests.proxy.relaying import Running, datagrams, eventually, port_of, running
from tests.proxy.test_rule_policy import rules


def test_each_client_has_its_own_way_and_bytes_pass_unchanged() -> None:
    said = [b"", b"\0", bytes(range(256)) * 100, b"\x01" * 65507]
    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        datagrams(to=proxy.address) as one,
        datagrams(to=proxy.address) as other,
    ):
        ways = set()
        for client in (one, other):
            for data in said:
                client.send(data)
                heard, way = server.recvfrom(65536)
                assert heard == data
                ways.add(way)
                server.sendto(data[::-1], way)
                assert client.recv(65536) == data[::-1]
        assert len(ways) == 2
        eventually(lambda: len(proxy.passed(False)) == 8)
        assert proxy.passed(True) == said * 2
        first = next(record for record in proxy.records if record.kind is RingRecordKind.DATA)
        assert 0 < first.sent_at - first.received_at < 10**10
        assert list(proxy.relay.counts)[:4] == [8, 8, 8, 8]


def test_a_client_that_starts_again_on_its_port_keeps_its_way() -> None:
    with datagrams() as server, running(port_of(server), "udp") as proxy:
        with datagrams(to=proxy.address) as client:
            port = port_of(client)
            client.send(b"one")
            _, way = server.recvfrom(100)
        with datagrams(port, proxy.address) as client:
            client.send(b"two")
            assert server.recvfrom(100) == (b"two", way)


def test_a_refusal_is_told_once_and_what_follows_is_still_sent() -> None:
    with datagrams() as server:
        port = port_of(server)
    with running(port, "udp") as proxy, datagrams(to=proxy.address) as client:
        for _ in range(5):
            client.send(b"anybody?")
        eventually(lambda: "refuses datagrams" in proxy.notices())
        (session,) = proxy.relay.sessions.values()
        assert session.upstream_state == "refused"
        with datagrams(port) as server:
            client.send(b"now?")
            heard, way = server.recvfrom(100)
            while heard != b"now?":
                heard, way = server.recvfrom(100)
            server.sendto(b"here", way)
            assert client.recv(100) == b"here"
            assert session.upstream_state == "open"
        assert proxy.notices().count("refuses datagrams") == 1


def test_silent_clients_are_forgotten_and_may_come_again() -> None:
    with (
        datagrams() as server,
        running(port_of(server), "udp", forget_after=1_000_000) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"one")
        _, way = server.recvfrom(100)
        eventually(lambda: proxy.of(RingRecordKind.CLIENT_CLOSED), "forgetting")
        assert not proxy.relay.sessions
        client.send(b"two")
        heard, other = server.recvfrom(100)
        assert heard == b"two"
        assert other != way


def test_a_client_that_has_spoken_twice_may_come_again_too() -> None:
    with (
        datagrams() as server,
        running(port_of(server), "udp", forget_after=1_000_000_000) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"one")
        client.send(b"two")
        assert server.recv(100) == b"one"
        _, way = server.recvfrom(100)
        eventually(lambda: proxy.of(RingRecordKind.CLIENT_CLOSED), "forgetting")
        assert decoded(proxy.of(RingRecordKind.CLIENT_CLOSED)[0].data) == "silent for 1 s"
        client.send(b"three")
        heard, other = server.recvfrom(100)
        assert heard == b"three"
        assert other != way


def test_requests_from_before_the_start_are_not_forwarded() -> None:
    with datagrams() as server, datagrams() as client:
        relay = Relay(RingWriter(memoryview(bytearray(RING_OVERHEAD + (1 << 16)))))
        (spec,) = parse_listener_specs(["127.0.0.1:0"], [f"127.0.0.1:{port_of(server)}"], "udp", [])
        address, listeners = open_listeners(relay, spec)
        for _ in range(3):
            client.sendto(b"old", address)
        relay.listen(listeners)
        client.sendto(b"new", address)
        proxy = Running(relay, address, RingReader(memoryview(bytearray(RING_OVERHEAD + 1024))))
        try:
            assert server.recv(100) == b"new"
        finally:
            proxy.stop()
            relay.close()


@contextmanager
def stopped_behind_a_client(
    forget_after: int = udp_listener.EXPIRE_AFTER_NS,
) -> Iterator[tuple[Relay, socket.socket]]:
    """Let a relay meet a client, and run no more; yield it and the controller."""
    with (
        datagrams() as server,
        running(port_of(server), "udp", forget_after=forget_after) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"one")
        server.recv(100)
        proxy.stop()
        yield proxy.relay, server


def test_who_is_silent_is_not_told_by_a_clock_that_is_put_forward(monkeypatch: pytest.MonkeyPatch) -> None:
    with stopped_behind_a_client() as (relay, _):
        later = time.time_ns() + 10 * udp_listener.EXPIRE_AFTER_NS
        monkeypatch.setattr(time, "time_ns", lambda: later)
        relay._sweep()
        assert relay.sessions
        monkeypatch.undo()
        relay.now += udp_listener.EXPIRE_AFTER_NS + 10**9
        relay._sweep()
        assert not relay.sessions


def test_after_a_long_standstill_clients_may_speak_before_they_are_called_silent() -> None:
    with stopped_behind_a_client(forget_after=10**9) as (relay, _):
        (session,) = relay.sessions.values()
        relay.now = session.last_heard = relay.now - 10**10  # as after ten seconds in which nothing ran
        relay._tick_count = relay_module.SWEEP_EVERY - 1
        relay._tick()
        assert relay.sessions
        relay._sweep()
        assert not relay.sessions


def test_a_stop_that_is_held_is_sent_before_its_client_is_forgotten() -> None:
    halt = encode_frame(9, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))
    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=rules("delay=1000s", clients=0)) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(halt)
        eventually(lambda: proxy.passed(True))
        (session,) = proxy.relay.sessions.values()
        proxy.stop()
        session.close(False, Message("client.silent", seconds=1))
        assert server.recv(100) == halt


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="only Linux lists open files")
def test_file_descriptors_kept_for_stops_are_opened_again_after_their_use() -> None:
    with stopped_behind_a_client() as (relay, _):
        assert relay.free_descriptor()
        opened = len(os.listdir("/proc/self/fd"))
        relay._sweep()
        assert len(os.listdir("/proc/self/fd")) == opened + 1


def test_a_datagram_that_is_refused_twice_was_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    with stopped_behind_a_client() as (relay, _):
        (session,) = relay.sessions.values()
        monkeypatch.setattr(session, "_send_up", refuse)
        assert session.send(True, b"two") == 0
        assert relay.counts[RelayCounter.FULL] == 1


def refuse(_: bytes) -> int:
    raise ConnectionRefusedError


def test_strangers_are_told_once_and_dropped() -> None:
    with datagrams() as server, running(port_of(server), "udp", allow=["10.0.0.0/8"]) as proxy:
        with datagrams(to=proxy.address) as client:
            for _ in range(3):
                client.send(b"let me in")
            eventually(lambda: proxy.relay.counts[RelayCounter.DENIED] == 3)
        eventually(proxy.notices)
        assert proxy.notices().count("is not allowed") == 1
        server.settimeout(0)
        try:
            raise AssertionError(server.recv(100))
        except BlockingIOError:
            pass


@contextmanager
def idle_listener(*allow: str) -> Iterator[tuple[Relay, udp_listener.UdpListener, RingReader]]:
    """Listen with a relay that does not run, so that a test can choose the address of a client."""
    memory = memoryview(bytearray(RING_OVERHEAD + (1 << 16)))
    relay = Relay(RingWriter(memory))
    (spec,) = parse_listener_specs(["127.0.0.1:0"], ["127.0.0.1:9"], "udp", allow)
    _, (listener,) = open_listeners(relay, spec, udp_listener.EXPIRE_AFTER_NS)
    relay.listen([listener])
    assert isinstance(listener, udp_listener.UdpListener)
    try:
        yield relay, listener, RingReader(memory)
    finally:
        relay.close()


def test_at_most_256_strangers_are_reported() -> None:
    with idle_listener("10.0.0.0/8") as (relay, listener, reader):
        for number in range(300):
            assert listener.session_for((f"172.16.{number // 100}.{number % 100}", 5), b"") is None
        records = [*reader.read_records(), *reader.read_records()]
        assert sum(each.kind is RingRecordKind.NOTICE for each in records) == 256
        assert relay.counts[RelayCounter.DENIED] == 300


HALT = encode_frame(5, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))


@pytest.mark.parametrize(("first", "is_admitted"), [(HALT, True), (encode_frame(5, 0, 1), False)])
def test_only_a_stop_gets_a_spare_descriptor(
    first: bytes, is_admitted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors = [OSError(errno.EMFILE, "")]

    def connect_if_free(*controller: Any) -> socket.socket:
        if errors:
            raise errors.pop()
        return connect_datagrams(*controller)

    with idle_listener() as (_, listener, _reader):
        monkeypatch.setattr(udp_listener, "connect_datagrams", connect_if_free)
        assert (listener.session_for(("127.0.0.1", 5), first) is not None) is is_admitted


def test_without_spare_descriptors_only_a_stop_gets_a_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    with idle_listener() as (relay, listener, _):
        monkeypatch.setattr(relay.spares, "refill", lambda: False)
        assert listener.session_for(("127.0.0.1", 5), encode_frame(5, 0, 1)) is None
        assert not relay.slots[Transport.UDP].end_oldest_stop()
        session = listener.session_for(("127.0.0.1", 6), HALT)
        assert list(relay.sessions.values()) == [session]
        assert relay.slots[Transport.UDP].end_oldest_stop()
        assert not relay.sessions


@contextmanager
def crowded(server: socket.socket, proxy: Running) -> Iterator[list[socket.socket]]:
    """Take all places by clients that have spoken twice; yield them."""
    with ExitStack() as stack:
        clients = []
        for number in range(MAX_CLIENTS):
            client = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            client.bind(("127.0.0.1" if number < MAX_PER_SOURCE else "127.0.0.2", 0))
            client.connect(proxy.address)
            for _ in range(2):
                client.send(b"me")
                server.recv(100)
            clients.append(client)
        yield clients


def test_one_client_too_many_waits_until_one_is_silent() -> None:
    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        crowded(server, proxy),
        datagrams(to=proxy.address) as late,
    ):
        late.send(b"too many")
        eventually(lambda: proxy.relay.counts[RelayCounter.DENIED] == 1)
        eventually(
            lambda: "exceeds the maximum number of clients; its datagrams are dropped" in proxy.notices()
        )
        silent = next(iter(proxy.relay.sessions.values()))
        silent.last_heard -= udp_listener.EVICTABLE_AFTER_NS
        server.settimeout(0.1)
        heard = b""
        while heard != b"room now":
            late.send(b"room now")
            with suppress(TimeoutError):
                heard = server.recv(100)
        eventually(
            lambda: [
                record for record in proxy.of(RingRecordKind.CLIENT_CLOSED) if record.client == silent.number
            ]
        )


def test_a_stop_gets_through_when_all_places_are_taken() -> None:
    halt = encode_frame(1, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))
    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        crowded(server, proxy) as clients,
    ):
        for _ in range(10):
            with datagrams(to=proxy.address) as late:
                late.send(halt)
                heard, way = server.recvfrom(100)
                assert heard == halt
                server.sendto(b"ok", way)
                assert late.recv(10) == b"ok"
        for client in (clients[0], clients[-1]):
            client.send(b"still there")
            assert server.recv(100) == b"still there"


def test_a_flood_from_ever_new_ports_leaves_established_clients_alone() -> None:
    with datagrams() as server, running(port_of(server), "udp") as proxy, datagrams(to=proxy.address) as one:
        for _ in range(2):
            one.send(b"established")
            _, way = server.recvfrom(100)
        server.settimeout(0.01)
        for number in range(600):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
                flood.sendto(b"flood", proxy.address)
            if number % 100 == 99:
                one.send(b"still here")
                heard = b""
                while heard != b"still here":
                    with suppress(TimeoutError):
                        heard, came = server.recvfrom(100)
                assert came == way
        assert len(proxy.relay.sessions) <= MAX_PER_SOURCE
        assert proxy.relay.counts[RelayCounter.DENIED]


def test_what_cannot_be_sent_is_told_and_the_relay_goes_on() -> None:
    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"one")
        _, way = server.recvfrom(100)
        session = next(iter(proxy.relay.sessions.values()))
        assert session.send(True, bytes(65536)) == 0
        assert proxy.relay.counts[RelayCounter.FULL] == 1
        eventually(lambda: "65536 bytes could not be sent: message too long" in proxy.notices())
        assert "refuses" not in proxy.notices()
        assert session.upstream_state == "open"
        server.sendto(b"still there", way)
        assert client.recv(100) == b"still there"


def test_each_dropped_reply_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with stopped_behind_a_client() as (relay, _):
        (session,) = relay.sessions.values()
        for dropped in (3, 3, 5):
            monkeypatch.setattr(udp_listener, "dropped_datagrams", lambda sock, dropped=dropped: dropped)
            session.sweep(relay.now)
            assert relay.counts[RelayCounter.LOST] == dropped


def test_full_buffers_of_the_system_are_counted() -> None:
    with datagrams() as server:
        memoryless = running(port_of(server), "udp")
        with memoryless as proxy, datagrams(to=proxy.address) as client:
            client.send(b"one")
            server.recv(100)
            port = proxy.relay._listeners[0]
            assert isinstance(port, udp_listener.UdpListener)
            port.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            for _ in range(10_000):
                client.send(bytes(1000))
            eventually(lambda: proxy.relay.counts[RelayCounter.LOST] > 0, "counting")


def test_leaving_asks_each_thing_after_the_answer_to_the_one_before() -> None:
    with datagrams() as server, running(port_of(server), "udp") as proxy:
        with datagrams(to=proxy.address) as client:
            client.send(b"hello")
            _, way = server.recvfrom(100)
        proxy.stop()
        session = next(iter(proxy.relay.sessions.values()))
        assert isinstance(session, udp_listener.UdpSession)
        requests = [bytes(5) + bytes([number, 0]) + bytes(9) for number in (1, 2, 3)]
        answers = {1: bytes(16), 2: bytes(9) + b"\0\x09\0\0" + bytes(3)}
        for number, answer in answers.items():
            server.sendto(answer[:5] + bytes([number, 0]) + answer[7:], way)
        until = time.monotonic() + 60
        assert (
            session.send_closing_requests(requests, until) == 1
        )  # the second is still at work, and never done
        asked = [server.recv(100)[5] for _ in range(3)]
        assert asked == [1, 2, 2]
        proxy.look()
        proxy.relay.close()
        assert [data[5] for data in proxy.passed(True)[1:]] == asked
        assert [data[5] for data in proxy.passed(False)] == [1, 2]
        own = [each for each in proxy.of(RingRecordKind.DATA) if each.up][1:]
        assert {each.received_at for each in own} == {0}  # no client sent these requests
        assert [each.client for each in proxy.of(RingRecordKind.CLIENT_CLOSED)] == [session.number]


def test_who_leaves_without_time_asks_nothing() -> None:
    with stopped_behind_a_client() as (relay, server):
        (session,) = relay.sessions.values()
        assert isinstance(session, udp_listener.UdpSession)
        assert session.send_closing_requests([b"bye"], time.monotonic()) == 0
        server.settimeout(0)
        with pytest.raises(BlockingIOError):
            server.recv(100)


def test_listening_on_all_addresses_the_one_in_use_is_recorded() -> None:
    with listen_on(Endpoint("0.0.0.0", 0), Transport.UDP) as sock:
        assert local_address_for(sock, ("127.0.0.1", 9)) == ("127.0.0.1", port_of(sock))


def test_no_way_to_a_controller_is_told_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_way(*_: object) -> socket.socket:
        raise OSError(errno.ENETUNREACH, "")

    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        datagrams(to=proxy.address) as client,
    ):
        monkeypatch.setattr("bcapscope.proxy.udp_listener.connect_datagrams", no_way)
        for _ in range(5):
            client.send(b"lost")
        eventually(lambda: proxy.notices().count("network is unreachable") == 3)  # the 1st, 2nd and 4th
        monkeypatch.undo()
        client.send(b"found")
        while server.recv(10) != b"found":
            pass
        assert proxy.notices().count("network is unreachable") == 3
