"""Real sockets on loopback."""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.listening_sockets import MAX_PER_SENDER, SimulatorListenError
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.scenario import read_scenario
from bcapscope.simulator.scenario_runner import ScenarioRunner
from bcapscope.simulator.simulator import MAX_CLIENTS, STOP_CLIENTS, Peer, Simulator, SimulatorOutput
from bcapscope.simulator.simulator_clock import SimulatorClock
from bcapscope.simulator.simulator_server import Address, SimulatorServer
from bcapscope.transport.first_frame_queue import MAX_PENDING
from bcapscope.transport.receive_timestamps import AncillaryData

START = encode_frame(1, 0, 1, [bstr("")])
HALT = encode_frame(1, 0, 70, [i4(1), bstr("")])


@pytest.fixture
def server() -> Iterator[SimulatorServer]:
    made = SimulatorServer(Simulator(PROFILES["rc8"], now=time.monotonic_ns()), "127.0.0.1", 0)
    yield made
    made.close()


def client(server: SimulatorServer, kind: socket.SocketKind) -> socket.socket:
    """Connect to the server."""
    made = socket.socket(socket.AF_INET, kind)
    made.settimeout(5)
    made.connect(server.address)
    return made


def exchange(server: SimulatorServer, sock: socket.socket, data: bytes) -> bytes:
    """Send bytes and return what is answered; the server makes as many steps as it needs."""
    sock.sendall(data)
    sock.setblocking(False)
    for _ in range(100):
        server.step(0.05)
        try:
            return sock.recv(4096)
        except BlockingIOError:
            continue
    raise AssertionError("no answer")


class Ends:
    """Keeps how TCP connections ended: by the client or not, and whether by reset."""

    def __init__(self, server: SimulatorServer) -> None:
        self.ends: list[tuple[bool, bool]] = []
        self._server = server.address

    def on_datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        raise AssertionError("there are none")

    def on_segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        pass

    def on_stream_end(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        self.ends.append((target == self._server, reset))

    def on_connection_end(self, client: Address, server: Address) -> None:
        self.ends.append((False, False))


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_both_transports_answer_on_one_port(server: SimulatorServer, kind: socket.SocketKind) -> None:
    with client(server, kind) as sock:
        assert Frame(exchange(server, sock, START)).code == 0
        assert Frame(exchange(server, sock, encode_frame(2, 0, 2))).code == 0


def test_a_bad_datagram_stops_nobody(server: SimulatorServer) -> None:
    with client(server, socket.SOCK_DGRAM) as sock:
        for bad in (b"", b"\x01" * 40, b"\x01" + bytes(600), START[:-1]):
            sock.send(bad)
        assert Frame(exchange(server, sock, START)).code == 0


def test_a_bad_frame_closes_its_connection_only(server: SimulatorServer) -> None:
    with client(server, socket.SOCK_STREAM) as bad, client(server, socket.SOCK_STREAM) as good:
        assert exchange(server, bad, START[:-1] + b"\x05" + b"\x01" * 40) == b""
        assert Frame(exchange(server, good, START)).code == 0


@contextmanager
def full(server: SimulatorServer) -> Iterator[list[socket.socket]]:
    """Take all places over TCP."""
    with ExitStack() as stack:
        socks = [stack.enter_context(client(server, socket.SOCK_STREAM)) for _ in range(MAX_CLIENTS)]
        for sock in socks:
            assert exchange(server, sock, START)
        yield socks


def test_one_connection_too_many_is_closed(server: SimulatorServer) -> None:
    with full(server) as socks:
        with client(server, socket.SOCK_STREAM) as more:
            assert exchange(server, more, START) == b""
        socks.pop().close()
        server.step(0.05)
        with client(server, socket.SOCK_STREAM) as more:
            assert Frame(exchange(server, more, START)).code == 0


def test_a_stop_is_answered_when_all_places_are_taken(server: SimulatorServer) -> None:
    with full(server) as socks, ExitStack() as stack:
        for _ in range(3 * STOP_CLIENTS):
            late = stack.enter_context(client(server, socket.SOCK_STREAM))
            assert Frame(exchange(server, late, HALT))
        assert Frame(exchange(server, socks[0], START))
        assert server.step(0) == []


def test_connections_that_say_nothing_take_no_place(server: SimulatorServer) -> None:
    with ExitStack() as stack:
        good = stack.enter_context(client(server, socket.SOCK_STREAM))
        assert Frame(exchange(server, good, START)).code == 0
        silent = []
        for number in range(2 * MAX_PENDING):
            sock = stack.enter_context(client(server, socket.SOCK_STREAM))
            if number % 2:
                sock.sendall(START[:9])
            silent.append(sock)
            server.step(0)
        late = stack.enter_context(client(server, socket.SOCK_STREAM))
        assert Frame(exchange(server, late, START)).code == 0
        assert Frame(exchange(server, good, START)).code == 0
        with pytest.raises(ConnectionResetError):
            silent[0].recv(1)


def test_without_file_descriptors_nothing_is_tried_again_and_again(
    server: SimulatorServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = 0

    def none_left(_: socket.socket) -> None:
        nonlocal tried
        tried += 1
        raise OSError(errno.EMFILE, "")

    with client(server, socket.SOCK_STREAM) as sock, client(server, socket.SOCK_DGRAM) as other:
        with monkeypatch.context() as patched:
            patched.setattr(socket.socket, "accept", none_left)
            assert Frame(exchange(server, other, START)).code == 0
            before = tried
            for _ in range(50):
                server.step(0.001)
            assert tried == before > 0
        assert Frame(exchange(server, sock, START)).code == 0  # within a second


def test_reset_closes_all_connections(server: SimulatorServer) -> None:
    with client(server, socket.SOCK_STREAM) as sock:
        exchange(server, sock, START)
        server.reset()
        assert exchange(server, sock, b"") == b""


def test_a_client_that_does_not_read_stops_nobody(server: SimulatorServer) -> None:
    with client(server, socket.SOCK_STREAM) as lazy, client(server, socket.SOCK_STREAM) as good:
        lazy.setblocking(False)
        for _ in range(200):
            try:
                lazy.send(START * 200)
            except BlockingIOError:
                break
            server.step(0)
        assert Frame(exchange(server, good, START)).code == 0


def test_a_client_that_asks_for_much_at_once_lets_others_have_their_turn() -> None:
    calls = []
    simulator = Simulator(PROFILES["rc8"], now=time.monotonic_ns(), report=lambda peer, _: calls.append(peer))
    server = SimulatorServer(simulator, "127.0.0.1", 0)
    with client(server, socket.SOCK_STREAM) as greedy, client(server, socket.SOCK_DGRAM) as good:
        exchange(server, greedy, START)
        greedy.sendall(START * 1000)
        assert Frame(exchange(server, good, START)).code == 0
        assert len(calls) < 100
    server.close()


class GoesOn(Simulator):
    """A simulator with a client that sets the pace.

    Attributes:
        heard: when each piece came.
    """

    runs_in_real_time = True

    def __init__(self) -> None:
        super().__init__(PROFILES["rc8"])
        self.heard: list[int] = []

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        self.heard.append(now)
        return []

    on_segment = on_datagram


def test_a_client_that_goes_on_is_heard_as_of_when_its_datagrams_came() -> None:
    simulator = GoesOn()
    server = SimulatorServer(simulator, "127.0.0.1", 0)
    now = time.time_ns()
    came = iter(now - ago * 1_000_000 for ago in (90, 60, 70, 30))

    def receive(size: int, control: int) -> tuple[bytes, AncillaryData, int, Address]:
        try:
            stamp = struct.pack("@ll", *divmod(next(came), 1_000_000_000))
        except StopIteration:
            raise BlockingIOError from None
        return b"x", [(1, 35, stamp)], 0, ("127.0.0.1", 9)

    server._receive = receive
    server._read_datagrams()
    while server.datagram_queue.waiting:
        server.step(0)
    assert [round((b - a) / 1e7) for a, b in pairwise(simulator.heard)] == [3, 0, 3]
    server.close()


def test_what_has_piled_up_on_a_connection_came_evenly() -> None:
    simulator, times = GoesOn(), [0]
    server = SimulatorServer(simulator, "127.0.0.1", 0)
    server._clock = SimulatorClock(simulator, lambda: times[0], lambda: 0)
    with client(server, socket.SOCK_STREAM) as sock:
        sock.sendall(bytes(60))
        while not simulator.heard:
            server.step(0.05)
        times[0] = 40_000_000
        sock.sendall((b"\x01" + bytes(98) + b"\x04") * 4)
        while len(simulator.heard) < 5:
            server.step(0.05)
    assert simulator.heard == [0, 10_000_000, 20_000_000, 30_000_000, 40_000_000]
    server.close()


def test_each_sender_of_datagrams_has_its_turn(server: SimulatorServer) -> None:
    with client(server, socket.SOCK_DGRAM) as greedy, client(server, socket.SOCK_DGRAM) as good:
        exchange(server, greedy, START)
        for serial in range(2, 30):
            greedy.send(encode_frame(serial, 0, 1, [bstr("")]))
        good.send(START)
        good.setblocking(False)
        for _ in range(3):
            server.step(0)
        assert Frame(good.recv(4096)).code == 0
        answered = 0
        for _ in range(40):
            server.step(0)
        greedy.setblocking(False)
        while True:
            try:
                greedy.recv(4096)
            except BlockingIOError:
                break
            answered += 1
        assert (answered, server.datagram_queue.dropped) == (28, 0)


def test_what_one_sender_sends_too_fast_is_thrown_away_and_counted(server: SimulatorServer) -> None:
    with client(server, socket.SOCK_DGRAM) as greedy, client(server, socket.SOCK_DGRAM) as good:
        for serial in range(1, MAX_PER_SENDER + 12):
            greedy.send(encode_frame(serial, 0, 1, [bstr("")]))
        assert Frame(exchange(server, good, START)).code == 0
        assert server.datagram_queue.dropped == 10


def test_a_port_in_use_is_said(server: SimulatorServer) -> None:
    with pytest.raises(SimulatorListenError, match=f"port {server.address[1]}: address already in use"):
        SimulatorServer(Simulator(PROFILES["rc8"]), *server.address)


def test_an_address_of_another_machine_is_said() -> None:
    with pytest.raises(SimulatorListenError, match=r"cannot listen on 192\.0\.2\.1 TCP port 5007"):
        SimulatorServer(Simulator(PROFILES["rc8"]), "192.0.2.1", 5007)


@pytest.mark.parametrize("how", ["fin", "reset"])
def test_a_scenario_closes_a_connection(how: str) -> None:
    scenario = read_scenario(f"title: x\nfaults: [{{action: close, how: {how}}}]")
    now = time.monotonic_ns()
    made = SimulatorServer(
        ScenarioRunner(scenario, Simulator(scenario.controller_profile, now=now), now), "127.0.0.1", 0
    )
    with client(made, socket.SOCK_STREAM) as sock:
        if how == "fin":
            assert exchange(made, sock, START) == b""
        else:
            with pytest.raises(ConnectionResetError):
                exchange(made, sock, START)
    made.close()


def test_who_ended_a_connection_is_told_and_how(server: SimulatorServer) -> None:
    ends = server.tap = Ends(server)
    found = []
    for how in ("fin", "reset", "by the server"):
        with client(server, socket.SOCK_STREAM) as sock:
            exchange(server, sock, START)
            if how == "reset":
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
            if how == "by the server":
                server.reset()
            else:
                sock.close()
                while not ends.ends:
                    server.step(0.05)
        found.append(ends.ends)
        ends.ends = []
    gone = (False, False)
    assert found == [[(True, False), (False, False), gone], [(True, True), gone], [(False, False), gone]]
