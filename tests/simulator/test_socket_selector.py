"""Looking at sockets with what the system has for it, and without."""

from __future__ import annotations

import select
import socket

import pytest

from bcapscope.simulator.socket_selector import SocketSelector


@pytest.mark.parametrize("has_poll", [True, False])
def test_what_is_ready_is_told(has_poll: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not has_poll:
        monkeypatch.delattr(select, "poll", raising=False)
    one, other = socket.socketpair()
    with one, other:
        watch = SocketSelector([one.fileno()], [other.fileno()])
        for found in (watch.ready_now(), watch.wait(10)):
            assert found == ([], [other.fileno()])
        other.send(b"x")
        for found in (watch.ready_now(), watch.wait(10)):
            assert found == ([one.fileno()], [other.fileno()])
        idle = SocketSelector([other.fileno()], [])
        assert idle.ready_now() == idle.wait(0.001) == ([], [])


@pytest.mark.parametrize("has_poll", [True, False])
def test_a_socket_whose_other_end_is_gone_can_be_read(
    has_poll: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_poll:
        monkeypatch.delattr(select, "poll", raising=False)
    one, other = socket.socketpair()
    with one:
        other.close()
        assert SocketSelector([one.fileno()], []).ready_now() == ([one.fileno()], [])
