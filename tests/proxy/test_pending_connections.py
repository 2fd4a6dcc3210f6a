"""TCP clients that have not said anything yet, over real sockets."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import cast

import pytest

from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy.admission import MAX_CLIENTS, MAX_PER_SOURCE
from bcapscope.proxy.pending_connections import PendingConnections
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring_buffer import RelayCounter, RingRecordKind
from bcapscope.proxy.sockets import SocketAddress
from bcapscope.traffic.observation import Endpoint
from bcapscope.transport import first_frame_queue
from bcapscope.transport.first_frame_queue import FIRST_FRAME_TIMEOUT, MAX_PENDING
from tests.proxy.relaying import PATIENCE, Running, eventually, listening, port_of, running

START = encode_frame(1, 0, 1, (Variant(VT.BSTR, ""),))
HALT = encode_frame(1, 0, 70, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))


@contextmanager
def entering() -> Iterator[tuple[socket.socket, Running, ExitStack]]:
    """Run a relay that clients have to speak to; yield the controller's door and the relay."""
    with listening() as door, running(port_of(door), "tcp", waits=True) as proxy, ExitStack() as stack:
        yield door, proxy, stack


def connect(proxy: Running, stack: ExitStack, host: str = "127.0.0.1") -> socket.socket:
    """Connect from an address of this machine."""
    client = socket.create_connection(proxy.address, PATIENCE, source_address=(host, 0))
    return stack.enter_context(client)


def admit(door: socket.socket, proxy: Running, stack: ExitStack, host: str = "127.0.0.1") -> socket.socket:
    """Connect, say something and be heard by the controller."""
    client = connect(proxy, stack, host)
    client.sendall(START)
    server = stack.enter_context(door.accept()[0])
    server.settimeout(PATIENCE)
    assert server.recv(100) == START
    return client


def is_cut_off(client: socket.socket) -> bool:
    with suppress(ConnectionResetError):
        return client.recv(1) == b""
    return True


def test_the_controller_hears_of_a_client_with_its_first_frame() -> None:
    with entering() as (door, proxy, stack):
        client = connect(proxy, stack)
        client.sendall(START[:7])
        door.settimeout(0.2)
        with pytest.raises(TimeoutError):
            door.accept()
        assert not proxy.relay.sessions
        client.sendall(START[7:] + b"and more")
        door.settimeout(PATIENCE)
        server = stack.enter_context(door.accept()[0])
        server.settimeout(PATIENCE)
        assert server.recv(100) == START + b"and more"
        server.sendall(b"answer")
        assert client.recv(100) == b"answer"
        eventually(lambda: len(proxy.of(RingRecordKind.DATA)) == 2)
        (opened,), first = proxy.of(RingRecordKind.CLIENT_OPENED), proxy.of(RingRecordKind.DATA)[0]
        assert opened.received_at == first.received_at <= first.sent_at


def test_clients_that_say_nothing_leave_nothing() -> None:
    with entering() as (_, proxy, stack):
        for number in range(20):
            client = connect(proxy, stack)
            if number % 2:
                client.sendall(START[:3])
            client.close()
        eventually(lambda: not len(proxy.relay.pending_connections))
        assert not proxy.relay.counts[RelayCounter.CLIENTS]
        assert not proxy.of(RingRecordKind.CLIENT_OPENED)


def test_the_oldest_silent_client_makes_room_and_who_speaks_is_served() -> None:
    with entering() as (door, proxy, stack):
        silent = [connect(proxy, stack) for _ in range(MAX_PENDING)]
        client = admit(door, proxy, stack)
        assert is_cut_off(silent[0])
        notices = "was silent, and other clients wanted to connect; its connection is closed"
        eventually(lambda: notices in proxy.notices())
        assert proxy.relay.counts[RelayCounter.DENIED] == 1
        silent[1].sendall(START)
        stack.enter_context(door.accept()[0])
        client.close()


class Scene:
    """Stands for the relay of an entrance, and keeps what it is told."""

    def __init__(self) -> None:
        self.now = 10**12
        self.handlers: dict[int, Callable[[int], None]] = {}
        self.denied: list[str] = []
        self.admitted: list[bytes] = []
        self.entrance = PendingConnections(cast(Relay, self))

    def watch(self, descriptor: int, handler: Callable[[int], None]) -> None:
        self.handlers[descriptor] = handler

    def unwatch(self, descriptor: int) -> None:
        del self.handlers[descriptor]

    def deny(self, client: Endpoint, why: Message) -> None:
        self.denied.append(str(why))

    def come(self, stack: ExitStack, data: bytes = b"") -> socket.socket:
        """Let a client come that has sent `data` already; return its end."""
        here, there = socket.socketpair()
        stack.enter_context(there)
        there.sendall(data)
        self.entrance.add(here, ("10.0.0.1", 50000), self.admit)
        return there

    def admit(self, client: socket.socket, address: SocketAddress, first: bytes, came: int) -> None:
        assert came > 10**18
        self.admitted.append(first)
        client.close()


def test_a_first_frame_that_takes_too_long_ends_the_connection() -> None:
    scene = Scene()
    with ExitStack() as stack:
        slow, silent = scene.come(stack, START[:3]), scene.come(stack)
        scene.entrance.sweep(scene.now + FIRST_FRAME_TIMEOUT)
        assert not scene.denied
        scene.entrance.sweep(scene.now + FIRST_FRAME_TIMEOUT + 1)
        assert scene.denied == ["did not complete its first frame in time"]
        assert is_cut_off(slow)
        silent.setblocking(False)
        with pytest.raises(BlockingIOError):
            silent.recv(1)
        scene.entrance.close()
        assert not scene.handlers


def test_the_relay_looks_for_first_frames_that_take_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_frame_queue, "FIRST_FRAME_TIMEOUT", 1)
    with entering() as (_, proxy, stack):
        client = connect(proxy, stack)
        client.sendall(START[:3])
        assert is_cut_off(client)


def test_what_was_sent_with_the_connection_is_read_at_once() -> None:
    scene = Scene()
    with ExitStack() as stack:
        scene.come(stack, HALT)
        assert scene.admitted == [HALT]
        assert not scene.handlers


def test_a_silent_client_can_be_dropped_for_its_file_descriptor() -> None:
    scene = Scene()
    with ExitStack() as stack:
        client = scene.come(stack)
        assert scene.entrance.drop_lowest_priority()
        assert is_cut_off(client)
        assert scene.denied == ["was silent, and no file descriptors were left"]
        assert not scene.entrance.drop_lowest_priority()


def test_a_stop_gets_through_when_all_places_are_taken() -> None:
    with entering() as (door, proxy, stack):
        for number in range(MAX_CLIENTS):
            admit(door, proxy, stack, "127.0.0.1" if number < MAX_PER_SOURCE else "127.0.0.2")
        late = connect(proxy, stack, "127.0.0.3")
        late.sendall(START)
        assert is_cut_off(late)
        eventually(
            lambda: "exceeds the maximum number of clients; its connection is closed" in proxy.notices()
        )
        for host in ("127.0.0.1", "127.0.0.3") * 4:
            client = connect(proxy, stack, host)
            client.sendall(HALT)
            server = stack.enter_context(door.accept()[0])
            server.settimeout(PATIENCE)
            assert server.recv(100) == HALT
            server.sendall(b"ok")
            assert client.recv(10) == b"ok"


def test_an_ended_relay_leaves_no_connection_open() -> None:
    with listening() as door, ExitStack() as stack:
        with running(port_of(door), "tcp", waits=True) as proxy:
            client = connect(proxy, stack)
            eventually(lambda: len(proxy.relay.pending_connections))
        assert is_cut_off(client)
