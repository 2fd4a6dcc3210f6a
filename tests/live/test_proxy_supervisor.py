"""The process of the relay and the process that watches it."""

from __future__ import annotations

import errno
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from multiprocessing.shared_memory import SharedMemory

import pytest

from bcapscope.errors import FileWriteError
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.live import proxy_supervisor
from bcapscope.live.proxy_options import ProxyOptions, ViewOptions
from bcapscope.live.proxy_supervisor import ProxySupervisor, _shared_memory
from bcapscope.messages import Message
from bcapscope.player.realtime import RealtimeReport
from bcapscope.proxy.addons import AddonClient
from bcapscope.proxy.listener_spec import parse_listener_specs
from bcapscope.proxy.rule_policy import RulePolicy
from tests.proxy.scripting import Here

pytestmark = pytest.mark.lifecycle


class Stubborn:
    """A process that does not end by itself."""

    def __init__(self) -> None:
        self.is_killed = False

    def is_alive(self) -> bool:
        return not self.is_killed

    def kill(self) -> None:
        self.is_killed = True

    def join(self, seconds: float) -> None:
        """Do nothing."""


def test_who_is_asked_to_end_once_more_waits_for_no_summary(capsys: pytest.CaptureFixture[str]) -> None:
    here, there = socket.socketpair()
    here.setblocking(False)
    watcher = Stubborn()
    with here, there:
        proxy = ProxySupervisor(ProxyOptions(None, None, ViewOptions(None), "never"), here)
        proxy._watcher, proxy._is_watched = watcher, True  # type: ignore[assignment]
        there.send(bytes([signal.SIGINT]))
        proxy.close()
    assert watcher.is_killed
    assert "the last part of the recording may be missing" in capsys.readouterr().err


@contextmanager
def signalled_supervisor() -> Iterator[tuple[ProxySupervisor, socket.socket]]:
    """Yield a supervisor, and the socket that sends it the numbers of signals."""
    here, there = socket.socketpair()
    here.setblocking(False)
    options = ProxyOptions(None, None, ViewOptions(None), "never")
    with here, there, closing(ProxySupervisor(options, here)) as proxy:
        yield proxy, there


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there are no terminals that hang up")
def test_a_terminal_that_is_closed_does_not_ask_to_end_at_once() -> None:
    with signalled_supervisor() as (proxy, there):
        assert not proxy.must_end_now()
        there.send(bytes([signal.SIGHUP]))
        assert not proxy.must_end_now()
        there.send(bytes([signal.SIGHUP, signal.SIGTERM]))
        assert proxy.must_end_now()


def test_of_two_signals_before_the_start_the_second_ends_the_proxy_at_once() -> None:
    with signalled_supervisor() as (proxy, there):
        there.send(bytes([signal.SIGINT, signal.SIGINT]))
        with pytest.raises(KeyboardInterrupt):
            proxy.start_watcher(lambda seconds: False)
        assert proxy.must_end_now()


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="there is no such thing")
def test_memory_that_is_too_small_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "")

    unlinked: list[str] = []
    unlink = SharedMemory.unlink

    def noted(memory: SharedMemory) -> None:
        unlinked.append(memory.name)
        unlink(memory)

    monkeypatch.setattr(SharedMemory, "unlink", noted)
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(FileWriteError, match="no space left"):
        _shared_memory(4096)
    assert len(unlinked) == 1


class Diary:
    """An addon that notes who has gone, and the end."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def gone(self, client: AddonClient) -> None:
        self.lines.append("gone")

    def done(self) -> None:
        self.lines.append("done")


def test_scripts_are_told_of_the_end_after_all_clients_have_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        proxy_supervisor,
        "realtime_priority",
        lambda: nullcontext(RealtimeReport(True, True, Message("play.realtime.off"))),
    )
    diary = Diary()
    here, there = socket.socketpair()
    here.setblocking(False)
    policy = RulePolicy(FaultInjector((), now=0), scripts=Here(diary).queue)
    (listener,) = parse_listener_specs(["udp:127.0.0.1:0"], ["127.0.0.1:9"])
    with (
        here,
        there,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
        closing(ProxySupervisor(ProxyOptions(None, None, ViewOptions(None), "never"), here, policy)) as proxy,
    ):
        address = proxy.listen(listener, 10**12)

        def greet() -> None:
            client.sendto(b"x", address)
            there.send(bytes([signal.SIGINT]))

        proxy.run(greet)
    assert diary.lines == ["gone", "done"]


def test_who_hears_of_an_answer_that_is_taken_already_does_not_wait_for_another() -> None:
    here, there = socket.socketpair()
    with (
        here,
        there,
        closing(ProxySupervisor(ProxyOptions(None, None, ViewOptions(None), "never"), here)) as proxy,
    ):
        proxy._watcher_end.send_bytes(b"[]")
        hearing = threading.Thread(
            target=lambda: list(map(ProxySupervisor._receive_from_watcher, [proxy] * 2)), daemon=True
        )
        hearing.start()
        hearing.join(5)
        heard = not hearing.is_alive()
        proxy._watcher_end.close()  # would also wake who waits
        hearing.join(5)
    assert heard


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe cannot be waited for together with sockets")
@pytest.mark.parametrize("closed", [True, False], ids=["closed", "of no one"])
def test_a_proxy_whose_starter_is_gone_from_the_beginning_ends(
    monkeypatch: pytest.MonkeyPatch, closed: bool
) -> None:
    here, there = socket.socketpair()
    here.setblocking(False)
    with (
        here,
        there,
        open(os.devnull, "rb") as nobody,
        closing(ProxySupervisor(ProxyOptions(None, None, ViewOptions(None), "never"), here)) as proxy,
    ):
        monkeypatch.setattr(proxy_supervisor, "_STDIN", nobody.fileno())
        monkeypatch.setattr(sys, "stdin", None if closed else nobody)
        proxy.end_with_parent()
        proxy.relay.run(proxy._do_periodic_work)
