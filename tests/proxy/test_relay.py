"""What rules say is done: what is sent where, when, and what is told of it."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import pytest

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.proxy import poller
from bcapscope.proxy import relay as relay_module
from bcapscope.proxy.policy import CloseAction, PolicyAction, PolicyDecision, SendAction
from bcapscope.proxy.poller import SelectPoller
from bcapscope.proxy.relay import Relay, encode_note
from bcapscope.proxy.ring_buffer import RING_OVERHEAD, RelayCounter, RingRecordKind, RingWriter
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.tcp_session import MAX_PENDING, TcpSession
from bcapscope.traffic.observation import Conversation, Direction
from bcapscope.transport.socket_link import close_with_reset
from tests.english import decoded
from tests.proxy.relaying import PATIENCE, datagrams, eventually, listening, port_of, running
from tests.proxy.test_rule_policy import rules

DOWN = Direction.RESPONSE


def decided(client: int, note: str, *actions: SendAction | CloseAction, waiting: int = 0) -> PolicyDecision:
    """Return a decision with a note; "" for none."""
    return PolicyDecision(client, list(actions), [foreign_text(note)] if note else [], waiting)


class Say(RulePolicy):
    """A policy that a function makes; what is held goes out after its time, with its notes."""

    def __init__(self, decide: Callable[[int, Direction, bytes], PolicyDecision]) -> None:
        self.decide = decide
        self.held: list[tuple[int, PolicyAction]] = []
        self.told: list[str] = []
        self.now = 0

    def add_client(self, client: int, conversation: Conversation, now: int) -> None:
        self.told.append(f"{client} {conversation.client.host} {conversation.transport}")

    def receive(self, client: int, direction: Direction, data: bytes, now: int) -> PolicyDecision:
        self.now = now
        return self.decide(client, direction, data)

    def hold(self, action: PolicyAction, milliseconds: float) -> None:
        self.held.append((self.now + round(milliseconds * 1e6), action))

    def holds(self, client: int, direction: Direction) -> bool:
        return any(isinstance(each, SendAction) and each.toward is direction for _, each in self.held)

    def is_full(self, client: int) -> bool:
        return False

    def on_stream_end(self, client: int, direction: Direction, now: int) -> list[SendAction | CloseAction]:
        return []

    def hides_end(self, client: int) -> bool:
        return False

    def release_held(self, client: int, now: int) -> list[SendAction | CloseAction]:
        return []

    def remove_client(self, client: int, now: int) -> None:
        self.told.append(f"{client} gone")

    def due(self) -> int | None:
        return min((when for when, _ in self.held), default=None)

    def pop_due_actions(self, now: int) -> Sequence[PolicyAction]:
        ready = [action for when, action in self.held if when <= now]
        self.held = [each for each in self.held if each[0] > now]
        return ready

    def close(self, now: int) -> None:
        self.told.append("closed")

    def report(self) -> Sequence[Message]:
        return []


def test_drop_answer_and_pass() -> None:
    def decide(client: int, direction: Direction, data: bytes) -> PolicyDecision:
        if data == b"drop":
            return decided(client, "dropped")
        if data == b"answer":
            answer = SendAction(client, DOWN, b"by the proxy", foreign_text("made up"))
            return decided(client, "answered", answer)
        return decided(client, "", SendAction(client, direction, data))

    policy = Say(decide)
    with datagrams() as server, running(port_of(server), "udp", policy=policy) as proxy:
        with datagrams(to=proxy.address) as client:
            for data in (b"drop", b"answer", b"pass"):
                client.send(data)
            heard, way = server.recvfrom(100)
            assert heard == b"pass"
            assert client.recv(100) == b"by the proxy"
            server.sendto(b"pass back", way)
            assert client.recv(100) == b"pass back"
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 5)
        seen = [
            (record.data, decoded(record.note), bool(record.received_at), bool(record.sent_at))
            for record in proxy.of(RingRecordKind.DATA)
        ]
        assert seen == [
            (b"drop", "dropped", True, False),
            (b"answer", "answered", True, False),
            (b"by the proxy", "made up", False, True),
            (b"pass", "", True, True),
            (b"pass back", "", True, True),
        ]
        assert proxy.relay.counts[RelayCounter.RULED] == 2
    assert policy.told == ["1 127.0.0.1 udp", "1 gone"]


def test_what_still_waits_is_recorded_before_what_overtakes_it() -> None:
    def decide(client: int, direction: Direction, data: bytes) -> PolicyDecision:
        if data == b"waits":
            return decided(client, "", waiting=1)
        return decided(client, "", SendAction(client, direction, data))

    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=Say(decide)) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"waits")
        client.send(b"stop")
        assert server.recv(100) == b"stop"
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 2)
        assert [(record.data, bool(record.sent_at)) for record in proxy.of(RingRecordKind.DATA)] == [
            (b"waits", False),
            (b"stop", True),
        ]


def test_a_decision_about_what_was_recorded_already_is_still_carried_out() -> None:
    waiting: list[PolicyDecision] = []

    def decide(client: int, direction: Direction, data: bytes) -> PolicyDecision:
        if data == b"go":
            decision = waiting.pop()
            decision.notes.append(foreign_text("changed"))
            decision.actions = [SendAction(client, Direction.REQUEST, b"waited", foreign_text("changed"))]
            policy.hold(SendAction(99, DOWN, b"nobody"), 0)
            policy.hold(decision, 0)
            return decided(client, "", SendAction(client, direction, data))
        if data == b"waits":
            waiting.append(
                PolicyDecision(client, [SendAction(client, direction, b"at once")], waiting=1),
            )
            return waiting[-1]
        return decided(client, "", SendAction(client, direction, data))

    policy = Say(decide)
    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=policy) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        for data in (b"waits", b"overtakes", b"go"):
            client.send(data)
        assert [server.recv(100) for _ in range(4)] == [b"at once", b"overtakes", b"go", b"waited"]
        assert proxy.relay.counts[RelayCounter.RULED] == 1


def test_what_waits_for_a_decision_is_recorded_when_its_client_leaves() -> None:
    seen: list[bytes] = []

    def decide(client: int, _: Direction, data: bytes) -> PolicyDecision:
        seen.append(data)
        return decided(client, "", waiting=1)

    with listening() as door, running(port_of(door), "tcp", policy=Say(decide)) as proxy:
        client = socket.create_connection(proxy.address, PATIENCE)
        server, _ = door.accept()
        with server:
            client.sendall(b"question")
            server.sendall(b"answer")
            eventually(lambda: len(seen) == 2)
            close_with_reset(client)
            eventually(lambda: not proxy.relay.sessions)
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 2)
        assert sorted(proxy.passed(True) + proxy.passed(False)) == [b"answer", b"question"]


def test_what_waits_for_a_decision_is_recorded_when_a_client_on_udp_is_forgotten() -> None:
    seen: list[bytes] = []

    def decide(client: int, _: Direction, data: bytes) -> PolicyDecision:
        seen.append(data)
        return decided(client, "", waiting=1)

    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=Say(decide)) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"question")
        eventually(lambda: seen)
        proxy.stop()
        (session,) = proxy.relay.sessions.values()
        session.close(False, Message("client.ended"))
        eventually(lambda: proxy.passed(True) == [b"question"])


def test_what_waits_for_a_decision_is_recorded_before_the_end_of_its_stream() -> None:
    def decide(client: int, _: Direction, __: bytes) -> PolicyDecision:
        return decided(client, "", waiting=1)

    with (
        listening() as door,
        running(port_of(door), "tcp", policy=Say(decide)) as proxy,
        socket.create_connection(proxy.address, PATIENCE) as client,
        door.accept()[0],
    ):
        client.sendall(b"question")
        client.shutdown(socket.SHUT_WR)
        eventually(lambda: proxy.of(RingRecordKind.END))
        kinds = [each.kind for each in proxy.look() if each.kind in (RingRecordKind.DATA, RingRecordKind.END)]
        assert kinds[:2] == [RingRecordKind.DATA, RingRecordKind.END]


def test_the_ring_knows_the_streams_of_open_clients() -> None:
    with listening() as door, datagrams() as server, running(port_of(door), "tcp") as proxy:
        assert proxy.relay.ring.streams == set()
        with socket.create_connection(proxy.address, PATIENCE), door.accept()[0]:
            eventually(lambda: proxy.relay.ring.streams == {1})
        eventually(lambda: proxy.relay.ring.streams == set())
        with running(port_of(server), "udp") as other, datagrams(to=other.address) as client:
            client.send(b"x")
            assert server.recv(100) == b"x"
            assert other.relay.ring.streams == set()


def test_a_proxy_that_ends_ends_its_connections_in_order() -> None:
    with listening() as door, running(port_of(door), "tcp") as proxy:
        client = socket.create_connection(proxy.address, PATIENCE)
        server, _ = door.accept()
        eventually(lambda: proxy.relay.sessions)
        proxy.stop()
        proxy.relay.close()
        with client, server:
            server.settimeout(PATIENCE)
            assert (client.recv(1), server.recv(1)) == (b"", b"")
        with pytest.raises(ConnectionError):
            socket.create_connection(proxy.address, PATIENCE)


def test_nobody_gets_in_while_a_proxy_ends() -> None:
    with listening() as door, running(port_of(door), "tcp") as proxy:
        proxy.relay.close_listeners()
        with pytest.raises(ConnectionError):
            socket.create_connection(proxy.address, PATIENCE)


@pytest.mark.parametrize(("is_admitted", "pending_left", "spares_left"), [(True, 0, 4), (False, 1, 3)])
def test_a_stop_gets_a_descriptor_of_a_pending_client_and_a_new_client_gets_a_spare_one(
    is_admitted: bool, pending_left: int, spares_left: int
) -> None:
    relay = Relay(RingWriter(memoryview(bytearray(RING_OVERHEAD + 4096))))
    assert relay.spares.refill()
    here, there = socket.socketpair()
    with there:
        relay.pending_connections.add(here, ("10.0.0.1", 50000), lambda *_: None)
        assert relay.free_descriptor(is_admitted=is_admitted)
        assert relay.pending_connections.drop_lowest_priority() is bool(pending_left)
        assert sum(relay.spares.release_one() for _ in range(9)) == spares_left
    relay.close()


def test_a_long_note_is_cut() -> None:
    assert encode_note(None) == b""
    assert decoded(encode_note(foreign_text("x" * 4000))) == "x" * 4000
    assert decoded(encode_note(foreign_text("x" * 5000))) == "x" * 600


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="only Linux lists open files")
def test_a_relay_that_has_ended_leaves_no_file_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    with datagrams() as server, running(port_of(server)):
        pass
    assert len(os.listdir("/proc/self/fd")) <= before


def test_what_is_held_goes_out_when_it_is_due() -> None:
    def decide(client: int, direction: Direction, data: bytes) -> PolicyDecision:
        policy.hold(SendAction(client, direction, b"second"), 60)
        policy.hold(SendAction(client, direction, b"first"), 30)
        return decided(client, "held")

    policy = Say(decide)
    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=policy) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"later")
        assert server.recv(100) == b"first"
        assert server.recv(100) == b"second"
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 3)
        came, first, second = (
            record.received_at or record.sent_at for record in proxy.of(RingRecordKind.DATA)
        )
        assert first - came > 25e6
        assert second - came > 50e6


def test_what_is_due_does_not_wait_for_the_next_poll(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay_module, "POLL_INTERVAL", 10 * PATIENCE)
    with (
        datagrams() as server,
        running(port_of(server), "udp", policy=rules("delay=10ms")) as proxy,
        datagrams(to=proxy.address) as client,
    ):
        client.send(b"later")
        try:
            assert server.recv(100) == b"later"
        finally:
            proxy.relay.stop()
            client.send(b"wakes the relay, which then ends")


def test_the_end_of_a_stream_waits_for_what_is_held_before_it() -> None:
    def decide(client: int, direction: Direction, data: bytes) -> PolicyDecision:
        policy.hold(SendAction(client, direction, data), 80)
        return decided(client, "")

    policy = Say(decide)
    with (
        listening() as door,
        running(port_of(door), "tcp", policy=policy) as proxy,
        socket.create_connection(proxy.address, PATIENCE) as client,
    ):
        server, _ = door.accept()
        with server:
            server.settimeout(PATIENCE)
            client.sendall(b"bytes, then the end")
            client.shutdown(socket.SHUT_WR)
            assert server.recv(100) == b"bytes, then the end"
            assert server.recv(100) == b""


@pytest.mark.parametrize("reset", [True, False])
def test_rules_may_end_a_connection(reset: bool) -> None:
    policy = Say(
        lambda client, direction, data: decided(
            client, "", CloseAction(client, reset, foreign_text("the rule"))
        )
    )
    with listening() as door, running(port_of(door), "tcp", policy=policy) as proxy:
        with socket.create_connection(proxy.address, PATIENCE) as client:
            server, _ = door.accept()
            with server:
                server.settimeout(PATIENCE)
                client.sendall(b"x")
                for sock in (client, server):
                    if reset:
                        with pytest.raises(ConnectionResetError):
                            sock.recv(1)
                    else:
                        assert sock.recv(1) == b""
        eventually(lambda: proxy.of(RingRecordKind.CLIENT_CLOSED))
        ends = proxy.of(RingRecordKind.RESET if reset else RingRecordKind.END)
        assert [(end.up, end.received_at, bool(end.sent_at), decoded(end.data)) for end in ends] == [
            (up, 0, True, "the rule") for up in (True, False)
        ]
        assert "the rule" in proxy.notices()


def test_nothing_is_told_to_have_left_after_it_was_there() -> None:
    """Else a recording would show answers before their requests."""
    arrived = []
    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        datagrams(to=proxy.address) as client,
    ):
        for _ in range(50):
            client.send(b"ping")
            server.recv(100)
            arrived.append(time.time_ns())
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 50)
        left = [record.sent_at for record in proxy.of(RingRecordKind.DATA)]
    assert all(each <= there for each, there in zip(left, arrived, strict=True))


def test_without_epoll_and_timers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poller, "make_poller", SelectPoller)
    monkeypatch.setattr(relay_module, "open_ticker", lambda seconds: None)
    with listening() as door, datagrams(port_of(door)) as server, running(port_of(door)) as proxy:
        with datagrams(to=proxy.address) as client:
            client.send(b"datagram")
            heard, way = server.recvfrom(100)
            server.sendto(heard, way)
            assert client.recv(100) == b"datagram"
        with socket.create_connection(proxy.address, PATIENCE) as stream:
            accepted, _ = door.accept()
            with accepted:
                accepted.settimeout(PATIENCE)
                stream.sendall(b"stream")
                assert accepted.recv(100) == b"stream"
                proxy.relay.close_listeners()
                accepted.sendall(b"still open")
                assert stream.recv(100) == b"still open"
                stream.shutdown(socket.SHUT_WR)
                assert accepted.recv(100) == b""
                accepted.sendall(b"back")
                assert stream.recv(100) == b"back"
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 5)


def test_what_happened_to_a_file_descriptor_is_not_told_to_the_next_of_its_number() -> None:
    relay = Relay(RingWriter(memoryview(bytearray(RING_OVERHEAD + 4096))))
    calls: list[str] = []
    with ExitStack() as stack:
        pairs = [stack.enter_context(each) for _ in range(2) for each in socket.socketpair()]
        quiet = [stack.enter_context(each) for each in socket.socketpair()]
        numbers = [pairs[0].fileno(), pairs[2].fileno()]

        def first(number: int, other: int) -> None:
            """End both, and give the number of the other to somebody else at once."""
            relay.unwatch(number)
            relay.unwatch(other)
            os.dup2(quiet[0].fileno(), other)
            relay.watch(other, lambda _: calls.append("to the next"))
            relay.stop()

        for number, other in (numbers, reversed(numbers)):
            relay.watch(number, lambda _, both=(number, other): first(*both))  # type: ignore[misc]
        pairs[1].send(b"x")
        pairs[3].send(b"x")
        relay.run()
        assert calls == []
        quiet[1].send(b"x")
        relay.run(relay.stop)
        assert calls == ["to the next"] * len(calls) != []
        relay.close()


def test_who_asks_and_does_not_listen_is_not_read_while_answers_pile_up() -> None:
    answer = bytes(1 << 20)
    asked: list[bytes] = []

    def decide(client: int, direction: Direction, data: bytes) -> PolicyDecision:
        asked.append(data)
        return decided(client, "answered", SendAction(client, DOWN, answer, foreign_text("made up")))

    with (
        listening() as door,
        running(port_of(door), "tcp", policy=Say(decide)) as proxy,
        socket.create_connection(proxy.address, PATIENCE) as client,
        door.accept()[0],
    ):
        eventually(lambda: proxy.relay.sessions)
        (session,) = proxy.relay.sessions.values()
        assert isinstance(session, TcpSession)
        down = session._down
        while len(down.pending) <= MAX_PENDING:
            count = len(asked)
            client.send(b"x")
            eventually(lambda count=count: len(down.pending) > MAX_PENDING or len(asked) > count)  # type: ignore[misc]
        count = len(asked)
        client.send(b"y")
        with socket.create_connection(proxy.address, PATIENCE) as other:
            other.send(b"z")
            eventually(lambda: len(asked) > count)
        assert asked[count:] == [b"z"]
        rest = len(answer) * (count + 1)  # also the one to what is read then
        while rest:
            rest -= len(client.recv(1 << 20))
        assert asked[-1].endswith(b"y")


def test_memory_stays_flat() -> None:
    with (
        datagrams() as server,
        running(port_of(server), "udp") as proxy,
        datagrams(to=proxy.address) as client,
    ):
        sizes = []
        for _ in range(3):
            for _ in range(2000):
                client.send(b"ping")
                _, way = server.recvfrom(100)
                server.sendto(b"pong", way)
                client.recv(100)
            proxy.look()
            proxy.records.clear()
            sizes.append(
                len(proxy.relay.ring.pending_datagrams)
                + len(proxy.relay.sessions)
                + len(proxy.relay._handlers)
            )
        assert max(sizes) < 16 + 1 + 4
        assert proxy.relay.counts[RelayCounter.CAME_UP] >= 6000 - 16
