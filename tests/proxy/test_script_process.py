"""The process of the scripts: how it loads, what it is sent, and that nothing of it stays."""

from __future__ import annotations

import errno
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from bcapscope.errors import BcapError
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.proxy.poller import READ, WRITE, DescriptorWatcher, Handler
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.proxy.script_process import ScriptProcess
from bcapscope.proxy.script_protocol import (
    ClientConnected,
    FinishScripts,
    FrameUnpacker,
    MessageShown,
    ScriptAnswer,
    ScriptsLoaded,
    ScriptStatement,
    pack,
)
from bcapscope.proxy.script_queue import ScriptQueue
from tests.english import english
from tests.faults.traffic import CLIENT, SERVER, talk
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
WAITING = """import socket
link = socket.create_connection(("127.0.0.1", {port})); link.recv(1)
"""
FORKED = """import os, socket
if not os.fork():
    os.setsid()
    link = socket.create_connection(("127.0.0.1", {port})); link.settimeout(5)
    try:
        link.send(link.recv(1))
    finally:
        os._exit(0)
"""
EXITING = """import os
class Exiting:
    def connected(self, client): os._exit(3)
    def done(self): os._exit(3)
"""
LITTERING = """import gc, weakref
class Cycle: pass
gc.disable()
cycle = Cycle(); cycle.itself = cycle; litter = weakref.ref(cycle); del cycle
class Observer:
    def connected(self, client):
        assert litter() is None
        assert gc.get_freeze_count() > 1000
"""
REPLACING = """import os, stat
def is_socket(number):
    try:
        return stat.S_ISSOCK(os.fstat(number).st_mode)
    except OSError:
        return False
number = next(filter(is_socket, range(3, 64)))
os.dup2(number, 100)  # the proxy then sees the end only when the process has ended
os.dup2(os.open({path!r}, os.O_WRONLY | os.O_CREAT), number)
log = open(number, "w"); log.write("kept")
"""
HOST = """import sys
from bcapscope.proxy.script_host import main
main(int(sys.argv[1]), None, int(sys.argv[2]), [sys.argv[3]], 512)
"""
PROXY = """import sys, time
from bcapscope.proxy.script_process import ScriptProcess
process = ScriptProcess([sys.argv[1]]); time.sleep(600)
"""
CONNECTED = pack(ClientConnected(1, (CLIENT, SERVER), "udp"))
LARGE = CONNECTED + pack(MessageShown(1, True, bytes(1 << 22), 0, 0))
LINUX_ONLY = pytest.mark.skipif(sys.platform != "linux", reason="only Linux does this")
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


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


class Ticking(Clock):
    """Advances with each reading."""

    def __init__(self, step: float) -> None:
        self._step = step

    def __call__(self) -> float:
        self.now += self._step
        return self.now


@contextmanager
def ruled(
    folder: Path, text: str, clock: Callable[[], float] = time.monotonic
) -> Iterator[tuple[ScriptProcess, Watcher, RulePolicy]]:
    """Start a process for one script, and attach rules to it."""
    path = folder / "mine.py"
    path.write_text(text)
    watcher = Watcher()
    with closing(ScriptProcess([str(path)], clock=clock)) as process:
        rules = RulePolicy(FaultInjector(now=0), None, None, ScriptQueue("mine.py", process))
        process.attach(rules, watcher, lambda: False)
        yield process, watcher, rules


@contextmanager
def started(
    folder: Path, text: str, clock: Callable[[], float] = time.monotonic
) -> Iterator[tuple[ScriptProcess, Watcher]]:
    """Start a process for one script."""
    with ruled(folder, text, clock) as (process, watcher, _):
        yield process, watcher


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def counting(answers: list[ScriptStatement], count: int) -> Callable[[bytes], bool]:
    """Return a function that adds received answers to `answers` until there are `count` answers."""
    unpacker: FrameUnpacker[ScriptStatement] = FrameUnpacker(ScriptStatement)

    def is_done(data: bytes) -> bool:
        unpacker.feed_bytes(data)
        while (answer := unpacker.next_frame()) is not None:
            answers.append(answer)
        return len(answers) >= count

    return is_done


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


@LINUX_ONLY
def test_a_process_that_the_system_cannot_start_leaves_no_file_open() -> None:
    before = open_files()
    with pytest.raises(BcapError) as caught:
        ScriptProcess(["x" * (1 << 20)])
    assert str(caught.value).endswith(os.strerror(errno.E2BIG))
    assert open_files() == before


@LINUX_ONLY
def test_a_process_that_was_closed_leaves_no_file_open(tmp_path: Path) -> None:
    before = open_files()
    with started(tmp_path, OBSERVER) as (process, _):
        assert process.load(PATIENCE)
    assert open_files() == before


@LINUX_ONLY
def test_a_process_may_allocate_512_mb(tmp_path: Path) -> None:
    limit = "import resource\nassert resource.getrlimit(resource.RLIMIT_DATA) == (512 << 20, 512 << 20)\n"
    with started(tmp_path, limit + OBSERVER) as (process, _):
        assert process.load(PATIENCE)


def test_loaded_objects_are_kept_out_of_garbage_collection_after_one_collection(tmp_path: Path) -> None:
    answers: list[ScriptStatement] = []
    with started(tmp_path, LITTERING) as (process, _):
        assert process.load(PATIENCE)
        assert process.finish(CONNECTED, counting(answers, 1))
    assert answers == [ScriptAnswer()]


def test_a_process_that_reads_nothing_is_written_to_later(tmp_path: Path) -> None:
    with started(tmp_path, OBSERVER) as (process, watcher):
        assert process.load(PATIENCE)
        os.kill(process._process.pid, signal.SIGSTOP)
        process.send(LARGE[:-1])
        process.send(LARGE[-1:])
        assert watcher.masks == [READ, READ | WRITE]
        os.kill(process._process.pid, signal.SIGCONT)
        ((descriptor, handler),) = watcher.handlers.items()
        until = time.monotonic() + PATIENCE
        while watcher.masks[-1] != READ and time.monotonic() < until:
            select.select([], [descriptor], [], PATIENCE)
            handler(WRITE)
        assert watcher.masks == [READ, READ | WRITE, READ]
    with started(tmp_path, OBSERVER, Ticking(0.5)) as (process, watcher):
        assert process.load(PATIENCE)
        os.kill(process._process.pid, signal.SIGSTOP)
        assert not process.finish(bytes(1 << 22), lambda data: True)
        assert watcher.masks == [READ, 0]


def test_an_answer_reaches_the_rules(tmp_path: Path) -> None:
    with ruled(tmp_path, OBSERVER) as (process, watcher, rules):
        queue = rules.scripts
        assert queue is not None
        assert process.load(PATIENCE)
        assert queue.inspects_frames
        rules.add_client(1, talk().up.conversation, 0)
        assert queue.due() is not None
        ((descriptor, handler),) = watcher.handlers.items()
        assert select.select([descriptor], [], [], PATIENCE)[0]
        handler(READ)
        assert queue.due() is None
        assert watcher.masks == [READ]


def test_the_end_of_the_process_reaches_the_rules(tmp_path: Path) -> None:
    with ruled(tmp_path, EXITING) as (process, watcher, rules):
        assert process.load(PATIENCE)
        rules.add_client(1, talk().up.conversation, 0)
        ((descriptor, handler),) = watcher.handlers.items()
        assert select.select([descriptor], [], [], PATIENCE)[0]
        process.send(pack(FinishScripts()))
        handler(READ)
        assert watcher.masks == [READ, 0]
        assert rules.scripts is not None
        assert english(rules.scripts.off_because) == "its process ended during connected"


def test_the_answers_to_the_last_orders_are_passed_on(tmp_path: Path) -> None:
    answers: list[ScriptStatement] = []
    with started(tmp_path, OBSERVER, Ticking(0.001)) as (process, _):
        assert process.load(PATIENCE)
        assert process.finish(LARGE + pack(FinishScripts()), counting(answers, 3))
    assert answers == [ScriptAnswer()] * 3


def test_a_process_that_ends_before_its_last_answer_is_not_finished(tmp_path: Path) -> None:
    with started(tmp_path, EXITING) as (process, _):
        assert process.load(PATIENCE)
        assert not process.finish(pack(FinishScripts()), lambda data: True)


def test_scripts_have_3_s_for_their_end(tmp_path: Path) -> None:
    clock = Clock()
    asked: list[float] = []

    def is_interrupted() -> bool:
        asked.append(clock.now)
        clock.now = 12.999 if len(asked) == 1 else clock.now + 0.001
        return False

    with ruled(tmp_path, OBSERVER, clock) as (process, watcher, rules):
        process.attach(rules, watcher, is_interrupted)
        assert process.load(PATIENCE)
        clock.now = 10.0
        assert not process.finish(b"", lambda data: True)
    assert asked == [10.0, 12.999]


def test_a_signal_ends_the_wait_for_the_last_answer(tmp_path: Path) -> None:
    with ruled(tmp_path, OBSERVER) as (process, watcher, rules):
        process.attach(rules, watcher, lambda: True)
        assert process.load(PATIENCE)
        assert not process.finish(pack(FinishScripts()), lambda data: True)


def test_a_crash_is_reported_with_the_line_of_the_thread_that_crashed(tmp_path: Path) -> None:
    with (
        started(tmp_path, CRASHING) as (process, _),
        pytest.raises(BcapError, match=r"mine\.py.* line 6\b"),
    ):
        process.load(PATIENCE)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("os._exit(0)", "exit code 0"),
        ("os._exit(3)", "exit code 3"),
        ("os.kill(os.getpid(), 1)", "SIGHUP"),
        pytest.param("os.kill(os.getpid(), 40)", "signal 40", marks=LINUX_ONLY),
    ],
)
def test_a_script_that_ends_its_process_while_loading_says_how(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, why: str
) -> None:
    with started(tmp_path, f"import os\nprint('said')\n{text}") as (process, _):
        with pytest.raises(BcapError) as caught:
            process.load(PATIENCE)
        process.locate()  # does not signal the ended process
    assert str(caught.value).endswith(f"; {why}")
    assert capfd.readouterr().out == "said\n"


def test_a_file_that_a_script_opened_in_place_of_the_socket_is_written_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with (
        started(tmp_path, REPLACING.format(path=str(path)) + OBSERVER) as (process, _),
        pytest.raises(BcapError, match=r"exit code 1$"),
    ):
        process.load(PATIENCE)
    assert path.read_text() == "kept"


def test_scripts_may_load_for_30_s(tmp_path: Path) -> None:
    clock = Clock()
    with (
        listening() as door,
        started(tmp_path, WAITING.format(port=port_of(door)), clock) as (process, _),
    ):
        clock.now = 30.0
        assert not process.load(0)
        clock.now = 30.001
        with pytest.raises(BcapError, match="30 s"):
            process.load(0)


def test_the_proxy_waits_for_a_script_only_as_long_as_it_asks(tmp_path: Path) -> None:
    with started(tmp_path, "import time\ntime.sleep(5)\n" + OBSERVER) as (process, _):
        assert not process.load(0.01)


def test_a_script_that_never_loads_is_located_in_its_main_thread(tmp_path: Path) -> None:
    reason = ""
    for _ in range(20):  # on a busy machine, a process may be ended before it reports its line
        with (
            listening() as door,
            started(tmp_path, LOOPING.format(port=port_of(door)), clock := Clock()) as (process, _watcher),
        ):
            door.accept()[0].close()
            clock.now = 60.0
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
        started(tmp_path, PARENT.format(port=port_of(door)) + OBSERVER) as (process, watcher),
    ):
        assert process.load(PATIENCE)
        connection, _address = door.accept()
        with connection, suppress(ConnectionResetError):
            connection.settimeout(PATIENCE)
            process.end()
            assert watcher.masks == [READ, 0]
            assert connection.recv(1) == b""


def test_the_end_does_not_wait_for_a_process_that_left_the_session_of_the_script(tmp_path: Path) -> None:
    with (
        listening() as door,
        started(tmp_path, FORKED.format(port=port_of(door)) + OBSERVER) as (process, _),
    ):
        assert process.load(PATIENCE)
        connection, _address = door.accept()
        with connection:
            connection.settimeout(PATIENCE)
            process.end()
            connection.send(b"x")
            assert connection.recv(1) == b"x"


@LINUX_ONLY
def test_a_script_that_does_not_return_ends_with_a_killed_proxy(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    with listening() as door:
        path.write_text(WAITING.format(port=port_of(door)))
        with subprocess.Popen([sys.executable, "-c", PROXY, str(path)]) as proxy:
            connection, _address = door.accept()
            proxy.kill()
        with connection, suppress(ConnectionResetError):
            connection.settimeout(PATIENCE)
            assert connection.recv(1) == b""


@LINUX_ONLY
@pytest.mark.parametrize(
    ("parent", "sent"), [(os.getpid, pack(ScriptsLoaded(frozenset(["request"])))), (lambda: 0, b"")]
)
def test_scripts_are_loaded_only_while_their_proxy_runs(
    tmp_path: Path, parent: Callable[[], int], sent: bytes
) -> None:
    path = tmp_path / "mine.py"
    path.write_text(OBSERVER)
    here, there = socket.socketpair()
    with here, there:
        here.shutdown(socket.SHUT_WR)
        words = str(there.fileno()), str(parent()), str(path)
        subprocess.run([sys.executable, "-c", HOST, *words], pass_fds=[there.fileno()], check=True)
        there.close()
        assert here.recv(100) == sent
