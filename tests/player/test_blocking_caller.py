"""Calls without an event loop, on sockets that a test answers by hand."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator

import pytest

from bcapscope.player.blocking_caller import BlockingCaller, Channel, open_channel, run_blocking
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.retry.requester import CallAnswered, CallRefused, CallTimedOut, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.hresult import E_HANDLE, S_EXECUTING

MS = 1_000_000
QUICK = RetryPolicy(30 * MS, 1)
SLOW = RetryPolicy(20_000 * MS, 0)


def connected(address: tuple[str, int], tcp: bool) -> Channel:
    """Open a channel."""
    return open_channel(address[0], address[1], tcp)


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(20)
        yield sock


@pytest.fixture
def exchanger(server: socket.socket) -> Iterator[BlockingCaller]:
    made = BlockingCaller(connected(server.getsockname(), False), ReservedConvention.SEED)
    yield made
    made.close()


def begin(exchanger: BlockingCaller, pace: RetryPolicy = SLOW) -> int:
    """Begin a call; return when."""
    now = exchanger.link.now()
    exchanger.begin_call(19, (), pace, now)
    return exchanger.send_due()


def take(server: socket.socket) -> tuple[Frame, tuple[str, int]]:
    """Receive a request."""
    data, address = server.recvfrom(2048)
    return Frame(data), address


@pytest.mark.parametrize(("code", "kind"), [(0, CallAnswered), (E_HANDLE, CallRefused)])
def test_a_call_ends_with_its_reply(
    server: socket.socket, exchanger: BlockingCaller, code: int, kind: type
) -> None:
    sent = begin(exchanger)
    request, address = take(server)
    server.sendto(encode_frame(request.serial, 0, S_EXECUTING, ()), address)
    server.sendto(b"no frame", address)
    server.sendto(encode_frame(request.serial, 0, code, ()), address)
    settled = exchanger.wait_for_outcome(sent + 10_000 * MS)
    assert isinstance(settled, kind)


def test_what_is_not_answered_is_tried_again_and_then_given_up(
    server: socket.socket, exchanger: BlockingCaller
) -> None:
    sent = begin(exchanger, QUICK)
    settled = exchanger.wait_for_outcome(sent + 10_000 * MS)
    assert isinstance(settled, CallTimedOut)
    first, second = take(server)[0], take(server)[0]
    assert (first.reserved, second.reserved) == (0, first.serial)
    began, again = (each.sent for each in settled.attempts)  # time-outs count from when it was to be sent
    assert again >= began + 30 * MS


def test_it_is_left_alone_at_the_time_that_was_asked_for(exchanger: BlockingCaller) -> None:
    sent = begin(exchanger)
    assert exchanger.wait_for_outcome(sent + 5 * MS) is None
    assert sent + 5 * MS <= exchanger.link.now() < sent + 5000 * MS


def test_a_reply_after_the_last_try_is_heard(server: socket.socket, exchanger: BlockingCaller) -> None:
    sent = begin(exchanger, RetryPolicy(5 * MS, 0))
    settled = exchanger.wait_for_outcome(sent + 10_000 * MS)
    assert isinstance(settled, CallTimedOut)
    request, address = take(server)
    assert exchanger.wait_for_late_reply([request.serial], exchanger.link.now() + MS) is None
    server.sendto(encode_frame(request.serial, 0, 0, ()), address)
    late = exchanger.wait_for_late_reply([request.serial], exchanger.link.now() + 10_000 * MS)
    assert late is not None
    assert late in exchanger.late_replies


def test_a_closed_port_is_told_by_the_attempts() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        address = sock.getsockname()
    exchanger = BlockingCaller(connected(address, False), ReservedConvention.SEED)
    settled = run_blocking(exchanger.perform_call(19, (), QUICK))
    exchanger.close()
    assert isinstance(settled, CallTimedOut)
    assert [str(arrival.description) for arrival in settled.attempts[0].events] == ["connection refused"]


def test_a_stream_in_pieces_and_its_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        exchanger = BlockingCaller(connected(listening.getsockname(), True), ReservedConvention.TCP0)
        server, _ = listening.accept()
        sent = begin(exchanger)
        request = Frame(server.recv(2048))
        reply = encode_frame(request.serial, 0, 0, ())
        server.sendall(reply[:7])
        assert exchanger.wait_for_outcome(sent + 20 * MS) is None
        server.sendall(reply[7:])
        assert isinstance(exchanger.wait_for_outcome(sent + 10_000 * MS), CallAnswered)
        server.close()
        with pytest.raises(ConnectionResetError, match="the other end closed the connection"):
            run_blocking(exchanger.perform_call(19, (), SLOW))
        exchanger.close()


def test_a_watcher_sees_every_frame(server: socket.socket) -> None:
    seen: list[tuple[bool, bytes]] = []
    channel = connected(server.getsockname(), False)
    exchanger = BlockingCaller(channel, ReservedConvention.OWN, lambda sent, raw, _: seen.append((sent, raw)))
    sent = begin(exchanger)
    request, address = take(server)
    reply = encode_frame(request.serial, 0, 0, ())
    server.sendto(reply, address)
    exchanger.wait_for_outcome(sent + 10_000 * MS)
    exchanger.close()
    assert seen == [(True, request.raw), (False, reply)]


def test_a_step_that_waits_for_an_event_loop_is_a_mistake() -> None:
    with pytest.raises(RuntimeError, match="cannot run a coroutine"):
        run_blocking(asyncio.sleep(0))
