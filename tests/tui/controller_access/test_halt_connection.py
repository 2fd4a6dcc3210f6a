"""The line that HALT goes out on, before peers that are slow, busy or gone."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.live.controller.halt_connection import HaltConnection, HaltState, HaltUpdate
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED, E_BUSY, E_HANDLE
from tests.client.peer import Peer
from tests.client.server import UdpServer, answering, udp_server

LIMIT = 20.0
TARGET = ControllerTarget("127.0.0.1", 0, timeout=60_000.0)
HALT, SERVICE_START, ROBOT_GETATTRIBUTE = "Robot_Halt", 1, 77


class Heard:
    """What a line told."""

    def __init__(self) -> None:
        self.states: list[HaltState] = []
        self._more = threading.Condition()

    def take(self, news: HaltUpdate) -> None:
        with self._more:
            self.states.append(news.state)
            self._more.notify_all()

    def wait_for(self, state: HaltState) -> None:
        with self._more:
            assert self._more.wait_for(lambda: state in self.states, LIMIT), self.states


@contextmanager
def line(port: int, tcp: bool = False) -> Iterator[tuple[HaltConnection, Heard]]:
    heard = Heard()
    made = HaltConnection(replace(TARGET, port=port, tcp=tcp), heard.take, lambda seen: None, heartbeat=0.05)
    try:
        yield made, heard
    finally:
        made.close()


def until(true: Callable[[], bool]) -> None:
    ended = threading.Event()
    for _ in range(round(LIMIT / 0.01)):
        if true():
            return
        ended.wait(0.01)
    raise AssertionError("it did not come to that")


def calls(server: UdpServer) -> list[object]:
    return [name for peer in server.peers.values() for name in peer.functions]


def test_it_does_not_wait_for_the_call_that_proves_the_line_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    dropped = []

    def lossy(peer: Peer) -> None:
        received = peer.on_data

        def drop(data: bytes) -> None:
            if Frame(data).code == ROBOT_GETATTRIBUTE:
                dropped.append(data)
            else:
                received(data)

        monkeypatch.setattr(peer, "on_data", drop)

    with udp_server(lossy) as server, line(server.port) as (made, heard):
        until(lambda: bool(dropped))
        made.press()
        heard.wait_for(HaltState.HALTED)
        assert calls(server).count(HALT) == 1


def test_it_is_said_again_to_a_controller_that_is_busy() -> None:
    with answering(Robot_Halt=(E_BUSY, ())) as server, line(server.port) as (made, heard):
        heard.wait_for(HaltState.READY)
        made.press()
        until(lambda: calls(server).count(HALT) > 2)
        for peer in server.peers.values():
            peer.answers.clear()
        heard.wait_for(HaltState.HALTED)
        assert HaltState.FAILED not in heard.states


def test_where_nobody_listens_it_fails_after_some_tries_and_is_not_said_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("bcapscope.live.controller.halt_connection.RETRY_WITHIN", 0.3)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))  # and nobody listens there
        with line(probe.getsockname()[1], tcp=True) as (made, heard):
            made.press()
            heard.wait_for(HaltState.FAILED)
            heard.states.clear()
            heard.wait_for(HaltState.LOST)
            probe.listen()
            probe.settimeout(LIMIT)
            connection, _ = probe.accept()
            with connection:
                connection.settimeout(LIMIT)
                assert connection.recv(4096)  # Service_Start, which is not answered
                heard.wait_for(HaltState.OPENING)
                assert HaltState.HALTING not in heard.states


def forgetting(peer: Peer) -> None:
    """Have a peer that was told to refuse answer as before once the service is started anew."""
    received = peer.on_data

    def hear(data: bytes) -> None:
        if Frame(data).code == SERVICE_START:
            peer.answers.clear()
        received(data)

    setattr(peer, "on_data", hear)  # noqa: B010  # mypy takes no assignment to a method


def refuse(server: UdpServer, code: int, *functions: str) -> None:
    for peer in server.peers.values():
        peer.answers.update(dict.fromkeys(functions, (code, ())))


def test_a_controller_that_has_forgotten_the_line_is_halted_all_the_same() -> None:
    with udp_server(forgetting) as server, line(server.port) as (made, heard):
        heard.wait_for(HaltState.READY)
        made.pause_heartbeat(True)  # so that only HALT finds out
        refuse(server, E_HANDLE, HALT)
        made.press()
        heard.wait_for(HaltState.HALTED)
        assert HaltState.FAILED not in heard.states


def test_a_line_that_was_forgotten_is_not_called_ready() -> None:
    with udp_server(forgetting) as server, line(server.port) as (_, heard):
        heard.wait_for(HaltState.READY)
        refuse(server, E_HANDLE, "Robot_GetAttribute")
        heard.wait_for(HaltState.LOST)
        heard.states.clear()
        heard.wait_for(HaltState.READY)


def test_what_is_refused_on_a_new_line_too_has_failed() -> None:
    with answering(Robot_Halt=(E_ACCESSDENIED, ())) as server, line(server.port) as (made, heard):
        heard.wait_for(HaltState.READY)
        made.press()
        heard.wait_for(HaltState.FAILED)
        assert calls(server).count(HALT) == 2
