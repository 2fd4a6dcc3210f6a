"""The process of the scripts: how it loads, what it is sent, and that nothing of it stays."""

from __future__ import annotations

import errno
import os
import resource
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from bcapscope.errors import BcapError
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.proxy import script_process
from bcapscope.proxy.poller import READ, WRITE, DescriptorWatcher, Handler
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.script_process import ScriptProcess
from bcapscope.proxy.script_protocol import (
    FinishScripts,
    FrameUnpacker,
    ScriptAnswer,
    ScriptStatement,
    pack,
)
from bcapscope.proxy.script_queue import ScriptQueue
from tests.faults.traffic import talk
from tests.proxy.relaying import PATIENCE, listening, port_of

pytestmark = [
    pytest.mark.lifecycle,
    pytest.mark.skipif(sys.platform == "win32", reason="stops processes by signals"),
]

OBSERVER = """
class Observer:
    def request(self, message): pass
addons = [Observer()]
"""
CRASHING = """import os, threading
def wait():
    ready.set()
    threading.Event().wait()
ready = threading.Event(); threading.Thread(target=wait, daemon=True).start(); ready.wait()
os.abort()
"""
LOOPING = """import os, socket, threading
def wait():
    ready.set()
    threading.Event().wait()
ready = threading.Event(); threading.Thread(target=wait, daemon=True).start(); ready.wait()
link = socket.create_connection(("127.0.0.1", {port})); threading.Event().wait()
"""
PARENT = """
import socket, subprocess, sys
sock = socket.create_connection(("127.0.0.1", {port}))
subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], pass_fds=[sock.fileno()])
"""


class Watcher(DescriptorWatcher):
    """Notes for which events the process has the relay wait."""

    def __init__(self) -> None:
        self.masks: list[int] = []
        self.handlers: dict[int, Handler] = {}

    def watch(self, descriptor: int, handler: Handler, mask: int = READ) -> None:
        self.masks.append(mask)
        self.handlers[descriptor] = handler

    def change(self, descriptor: int, mask: int) -> None:
        self.masks.append(mask)

    def unwatch(self, descriptor: int) -> None:
        self.masks.append(0)


@contextmanager
def started(folder: Path, text: str) -> Iterator[tuple[ScriptProcess, Watcher]]:
    """Start a process for one script."""
    path = folder / "mine.py"
    path.write_text(text)
    watcher = Watcher()
    with closing(ScriptProcess([str(path)])) as process:
        queue = ScriptQueue("mine.py", process)
        process.attach(RulePolicy(FaultInjector(now=0), None, None, queue), watcher, lambda: False)
        yield process, watcher


def test_a_script_that_is_loaded_has_nothing_more_to_say(tmp_path: Path) -> None:
    with started(tmp_path, OBSERVER) as (process, watcher):
        assert process.load(PATIENCE)
        assert process.receive() is None
        process.send(b"\0\0\0\0")
        assert watcher.masks == [READ]


def test_a_script_that_cannot_be_used_says_why(tmp_path: Path) -> None:
    with started(tmp_path, "1 / 0") as (process, _), pytest.raises(BcapError, match="ZeroDivisionError"):
        process.load(PATIENCE)


def test_a_process_that_the_system_cannot_start_is_reported_in_words(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        with pytest.raises(BcapError) as caught:
            ScriptProcess([str(tmp_path / "mine.py")])
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert str(caught.value) == f"mine.py: cannot start a process: {os.strerror(errno.EMFILE)}"


def test_a_process_that_reads_nothing_is_written_to_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script_process, "FINISHES_WITHIN", 0.05)
    with started(tmp_path, OBSERVER) as (process, watcher):
        assert process.load(PATIENCE)
        os.kill(process._process.pid, signal.SIGSTOP)
        process.send(bytes(1 << 22))
        process.send(bytes(1))
        assert watcher.masks == [READ, READ | WRITE]
    with started(tmp_path, OBSERVER) as (process, watcher):
        assert process.load(PATIENCE)
        os.kill(process._process.pid, signal.SIGSTOP)
        assert not process.finish(bytes(1 << 22), lambda data: True)
        assert watcher.masks == [READ, 0]


def test_an_answer_reaches_the_rules(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(OBSERVER)
    watcher = Watcher()
    with closing(ScriptProcess([str(path)])) as process:
        queue = ScriptQueue("mine.py", process)
        rules = RulePolicy(FaultInjector(now=0), None, None, queue)
        process.attach(rules, watcher, lambda: False)
        assert process.load(PATIENCE)
        rules.add_client(1, talk().up.conversation, 0)
        assert queue.due() is not None
        ((descriptor, handler),) = watcher.handlers.items()
        assert select.select([descriptor], [], [], PATIENCE)[0]
        handler(READ)
        assert queue.due() is None


def test_the_answer_to_the_last_order_is_passed_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(script_process, "FINISHES_WITHIN", PATIENCE)
    answers: FrameUnpacker[ScriptStatement] = FrameUnpacker(ScriptStatement)

    def is_answered(data: bytes) -> bool:
        answers.feed_bytes(data)
        return answers.next_frame() == ScriptAnswer()

    with started(tmp_path, OBSERVER) as (process, _):
        assert process.load(PATIENCE)
        assert process.finish(pack(FinishScripts()), is_answered)


def test_a_crash_is_reported_with_the_line_of_the_thread_that_crashed(tmp_path: Path) -> None:
    with (
        started(tmp_path, CRASHING) as (process, _),
        pytest.raises(BcapError, match=r"mine\.py.* line 6\b"),
    ):
        process.load(PATIENCE)


def test_a_script_that_never_loads_is_located_in_its_main_thread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script_process, "LOADS_WITHIN", 0.0)
    reason = ""
    for _ in range(20):  # on a busy machine, a process may be ended before it reports its line
        with (
            listening() as door,
            started(tmp_path, LOOPING.format(port=port_of(door))) as (process, _watcher),
        ):
            door.accept()[0].close()
            with pytest.raises(BcapError) as caught:
                process.load(0)
        reason = str(caught.value)
        if "line" in reason:
            break
    assert "line 6" in reason


def test_a_process_that_was_closed_may_be_ended_again(tmp_path: Path) -> None:
    with started(tmp_path, OBSERVER) as (process, _):
        assert process.load(PATIENCE)
        process.close()
        assert list(map(str, process.end())) == ["SIGKILL"]


def test_what_a_script_has_started_ends_even_if_the_script_ended_first(tmp_path: Path) -> None:
    with (
        listening() as door,
        started(tmp_path, PARENT.format(port=port_of(door)) + "import os; os._exit(3)") as (process, _),
    ):
        connection, _address = door.accept()
        with connection, suppress(ConnectionResetError):
            connection.settimeout(PATIENCE)
            with pytest.raises(BcapError):
                process.load(PATIENCE)
            assert connection.recv(1) == b""


def test_what_a_script_has_started_ends_with_it(tmp_path: Path) -> None:
    with (
        listening() as door,
        started(tmp_path, PARENT.format(port=port_of(door)) + OBSERVER) as (process, _),
    ):
        assert process.load(PATIENCE)
        connection, _address = door.accept()
        with connection, suppress(ConnectionResetError):
            connection.settimeout(PATIENCE)
            process.end()
            assert connection.recv(1) == b""
