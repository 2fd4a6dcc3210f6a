"""Calls without an event loop, on sockets that a test answers by hand."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator

import pytest

from bcapscope.player.channel import SocketChannel, open_channel
from bcapscope.player.exchanger import BlockingExchanger, run
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import Frame, encode
from bcapscope.protocol.hresult import E_HANDLE, S_EXECUTING
from bcapscope.protocol.requester import Answered, Pace, Refused, TimedOut

MS = 1_000_000
QUICK = Pace(30 * MS, 1)
SLOW = Pace(20_000 * MS, 0)


def connected(address: tuple[str, int], tcp: bool) -> SocketChannel:
    """Open a channel."""
    return open_channel(address[0], address[1], tcp)


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(20)
        yield sock


@pytest.fixture
def exchanger(server: socket.socket) -> Iterator[BlockingExchanger]:
    made = BlockingExchanger(connected(server.getsockname(), False), Convention.SEED)
    yield made
    made.close()


def begin(exchanger: BlockingExchanger, pace: Pace = SLOW) -> int:
    """Begin a call; return when."""
    now = exchanger.link.now()
    exchanger.begin(19, (), pace, now)
    return exchanger.send()


def take(server: socket.socket) -> tuple[Frame, tuple[str, int]]:
    """Receive a request."""
    data, address = server.recvfrom(2048)
    return Frame(data), address


@pytest.mark.parametrize(("code", "kind"), [(0, Answered), (E_HANDLE, Refused)])
def test_a_call_ends_with_its_reply(
    server: socket.socket, exchanger: BlockingExchanger, code: int, kind: type
) -> None:
    sent = begin(exchanger)
    request, address = take(server)
    server.sendto(encode(request.serial, 0, S_EXECUTING, ()), address)
    server.sendto(b"no frame", address)
    server.sendto(encode(request.serial, 0, code, ()), address)
    settled = exchanger.settle(sent + 10_000 * MS)
    assert isinstance(settled, kind)


def test_what_is_not_answered_is_tried_again_and_then_given_up(
    server: socket.socket, exchanger: BlockingExchanger
) -> None:
    sent = begin(exchanger, QUICK)
    settled = exchanger.settle(sent + 10_000 * MS)
    assert isinstance(settled, TimedOut)
    first, second = take(server)[0], take(server)[0]
    assert (first.reserved, second.reserved) == (0, first.serial)
    began, again = (each.sent for each in settled.attempts)  # time-outs count from when it was to be sent
    assert again >= began + 30 * MS


def test_it_is_left_alone_at_the_time_that_was_asked_for(exchanger: BlockingExchanger) -> None:
    sent = begin(exchanger)
    assert exchanger.settle(sent + 5 * MS) is None
    assert sent + 5 * MS <= exchanger.link.now() < sent + 5000 * MS


def test_a_reply_after_the_last_try_is_heard(server: socket.socket, exchanger: BlockingExchanger) -> None:
    sent = begin(exchanger, Pace(5 * MS, 0))
    settled = exchanger.settle(sent + 10_000 * MS)
    assert isinstance(settled, TimedOut)
    request, address = take(server)
    assert exchanger.overdue([request.serial], exchanger.link.now() + MS) is None
    server.sendto(encode(request.serial, 0, 0, ()), address)
    late = exchanger.overdue([request.serial], exchanger.link.now() + 10_000 * MS)
    assert late is not None
    assert late in exchanger.late


def test_a_closed_port_is_told_by_the_attempts() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        address = sock.getsockname()
    exchanger = BlockingExchanger(connected(address, False), Convention.SEED)
    settled = run(exchanger.exchange(19, (), QUICK))
    exchanger.close()
    assert isinstance(settled, TimedOut)
    assert [arrival.what for arrival in settled.attempts[0].came] == ["connection refused"]


def test_a_stream_in_pieces_and_its_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        exchanger = BlockingExchanger(connected(listening.getsockname(), True), Convention.TCP0)
        server, _ = listening.accept()
        sent = begin(exchanger)
        request = Frame(server.recv(2048))
        reply = encode(request.serial, 0, 0, ())
        server.sendall(reply[:7])
        assert exchanger.settle(sent + 20 * MS) is None
        server.sendall(reply[7:])
        assert isinstance(exchanger.settle(sent + 10_000 * MS), Answered)
        server.close()
        with pytest.raises(ConnectionResetError, match="the peer closed the connection"):
            run(exchanger.exchange(19, (), SLOW))
        exchanger.close()


def test_a_watcher_sees_every_frame(server: socket.socket) -> None:
    seen: list[tuple[bool, bytes]] = []
    channel = connected(server.getsockname(), False)
    exchanger = BlockingExchanger(channel, Convention.OWN, lambda sent, raw, _: seen.append((sent, raw)))
    sent = begin(exchanger)
    request, address = take(server)
    reply = encode(request.serial, 0, 0, ())
    server.sendto(reply, address)
    exchanger.settle(sent + 10_000 * MS)
    exchanger.close()
    assert seen == [(True, request.raw), (False, reply)]


def test_a_step_that_waits_for_an_event_loop_is_a_mistake() -> None:
    with pytest.raises(RuntimeError, match="there is none"):
        run(asyncio.sleep(0))
