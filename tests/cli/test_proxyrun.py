"""The process of the relay and the process that watches it."""

from __future__ import annotations

import errno
import os
import signal
import socket
import sys
import threading
from contextlib import closing, nullcontext
from multiprocessing.shared_memory import SharedMemory

import pytest

from bcapscope.cli import proxyrun
from bcapscope.cli.files import FileRefused
from bcapscope.cli.proxyrun import Proxy, _share
from bcapscope.cli.proxywishes import Look, Wishes
from bcapscope.faults.shaper import Shaper
from bcapscope.player.realtime import Grade
from bcapscope.proxy.addons import Client
from bcapscope.proxy.rules import Rules
from bcapscope.proxy.spec import parse_listeners
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
        proxy = Proxy(Wishes(None, None, Look(None), "never"), here)
        proxy._watcher, proxy._watched = watcher, True  # type: ignore[assignment]
        there.send(bytes([signal.SIGINT]))
        proxy.close()
    assert watcher.is_killed
    assert "the last part of the recording may be missing" in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there are no terminals that hang up")
def test_a_terminal_that_is_closed_does_not_ask_to_end_at_once() -> None:
    here, there = socket.socketpair()
    here.setblocking(False)
    with here, there, closing(Proxy(Wishes(None, None, Look(None), "never"), here)) as proxy:
        assert not proxy.is_asked_again()
        there.send(bytes([signal.SIGHUP]))
        assert not proxy.is_asked_again()
        there.send(bytes([signal.SIGHUP, signal.SIGTERM]))
        assert proxy.is_asked_again()


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
    with pytest.raises(FileRefused, match="no space left"):
        _share(4096)
    assert len(unlinked) == 1


class Diary:
    """An addon that notes who has gone, and the end."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def gone(self, client: Client) -> None:
        self.lines.append("gone")

    def done(self) -> None:
        self.lines.append("done")


def test_scripts_are_told_of_the_end_after_all_clients_have_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proxyrun, "undisturbed", lambda: nullcontext(Grade(True, True, "")))
    diary = Diary()
    here, there = socket.socketpair()
    here.setblocking(False)
    policy = Rules(Shaper((), now=0), scripts=Here(diary).queue)
    (listener,) = parse_listeners(["udp:127.0.0.1:0"], ["127.0.0.1:9"])
    with (
        here,
        there,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
        closing(Proxy(Wishes(None, None, Look(None), "never"), here, policy)) as proxy,
    ):
        address = proxy.listen(listener, 10**12)

        def greet() -> None:
            client.sendto(b"x", address)
            there.send(bytes([signal.SIGINT]))

        proxy.run(greet)
    assert diary.lines == ["gone", "done"]


def test_who_hears_of_an_answer_that_is_taken_already_does_not_wait_for_another() -> None:
    here, there = socket.socketpair()
    with here, there, closing(Proxy(Wishes(None, None, Look(None), "never"), here)) as proxy:
        proxy._other_end.send_bytes(b"[]")
        hearing = threading.Thread(target=lambda: list(map(Proxy._hear, [proxy] * 2)), daemon=True)
        hearing.start()
        hearing.join(5)
        heard = not hearing.is_alive()
        proxy._other_end.close()  # would also wake who waits
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
        closing(Proxy(Wishes(None, None, Look(None), "never"), here)) as proxy,
    ):
        monkeypatch.setattr(proxyrun, "_STDIN", nobody.fileno())
        monkeypatch.setattr(sys, "stdin", None if closed else nobody)
        proxy.attend()
        proxy.relay.run(proxy._look_around)
