"""Run a command under attack, with an honest client beside the attacker.

Each attack shows four things: no traceback, no hang, bounded memory, and Robot_Halt answered within a second.
It also reports the round trips of an honest client as a ratio to those without the attack.
"""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from bcapscope.client import Blocking, connect, over_tcp, over_udp
from bcapscope.protocol.codec.frame import encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from tests.cli.proxying import Process, proxy, simulator

MEMORY_LIMIT = 300.0
"""MB that no process may exceed."""

HALT_LIMIT = 1.0
"""Seconds within which Robot_Halt is answered."""

PERIOD = 0.008
"""Seconds between two calls of the honest client: the period of slave mode."""

PATIENCE = 60.0
"""Seconds that a command may take to end."""

TRANSPORTS = ("tcp", "udp")

_ROBOT_HALT = 70
_SAMPLING_PERIOD = 0.05


@dataclass(frozen=True)
class RoundTrips:
    """What an honest client measured, in seconds."""

    calls: int
    p50: float
    p99: float
    longest: float


class HonestClient:
    """Reads the joints 125 times a second in a thread of its own, and measures each call."""

    def __init__(self, port: int, transport: str) -> None:
        self._port = port
        self._over = over_tcp if transport == "tcp" else over_udp
        self._times: list[float] = []
        self._error: BaseException | None = None
        self._ready = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="honest client", daemon=True)
        self._thread.start()
        assert self._ready.wait(PATIENCE), "the honest client did not connect"
        self._raise()

    def measure(self, seconds: float) -> RoundTrips:
        """Return the round trips of the next `seconds`; raise what ended the client."""
        first = len(self._times)
        self._stopping.wait(seconds)
        self._raise()
        times = sorted(self._times[first:])
        assert times, "the honest client was not answered"
        return RoundTrips(
            len(times), times[len(times) // 2], times[min(len(times) * 99 // 100, len(times) - 1)], times[-1]
        )

    def close(self) -> None:
        """End the thread and release what the client opened."""
        self._stopping.set()
        self._thread.join(PATIENCE)
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise AssertionError("the honest client failed") from self._error

    def _run(self) -> None:
        try:
            self._call_until_stopped()
        except Exception as error:  # reported to the test's own thread
            self._error = error
            self._stopping.set()
        finally:
            self._ready.set()

    def _call_until_stopped(self) -> None:
        with Blocking() as wait:
            service = wait.enter(connect(self._over("127.0.0.1", self._port)))
            controller = wait(service.connect("", "CaoProv.DENSO.VRC", "localhost"))
            robot = wait(controller.get_robot("Arm"))
            self._ready.set()
            while not self._stopping.is_set():
                began = time.perf_counter()
                joints = wait(robot.execute("CurJnt"))
                assert isinstance(joints, tuple)
                self._times.append(time.perf_counter() - began)
                self._stopping.wait(max(0.0, began + PERIOD - time.perf_counter()))


def halt_delay(port: int, transport: str) -> float:
    """Send Robot_Halt as the first frame of a new client; return the seconds until its reply.

    Over UDP the request is repeated every 50 ms, as clients do; over TCP the client connects again if its
    connection is reset. Any result code counts: it proves that the request reached the controller.
    """
    began = time.perf_counter()
    while not _is_halt_answered(port, transport):
        assert time.perf_counter() - began < PATIENCE, "Robot_Halt was not answered"
    return time.perf_counter() - began


def _is_halt_answered(port: int, transport: str) -> bool:
    request = encode_frame(1, 0, _ROBOT_HALT, (Variant(VT.I4, 1), Variant(VT.BSTR, "")))
    kind = socket.SOCK_STREAM if transport == "tcp" else socket.SOCK_DGRAM
    until = time.perf_counter() + PATIENCE
    with socket.socket(socket.AF_INET, kind) as client:
        client.settimeout(PATIENCE if transport == "tcp" else 0.05)
        try:
            client.connect(("127.0.0.1", port))
            while time.perf_counter() < until:
                client.send(request)
                try:
                    reply = client.recv(4096)
                except TimeoutError:
                    continue
                assert not reply or parse_datagram(reply)
                return bool(reply)
        except ConnectionError:
            time.sleep(0.01)
    return False


class MemoryWatch:
    """Samples the peak memory of a process and of everything that it started.

    Attributes:
        peak: MB; the most that any one of these processes held.
    """

    def __init__(self, pid: int) -> None:
        self.peak = 0.0
        self._pid = pid
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="memory watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop sampling."""
        self._stopping.set()
        self._thread.join(PATIENCE)

    def sample(self) -> None:
        """Take a sample now."""
        for pid in process_tree(self._pid):
            self.peak = max(self.peak, _high_water_mark(pid))

    def _run(self) -> None:
        while not self._stopping.wait(_SAMPLING_PERIOD):
            self.sample()


def process_tree(pid: int) -> list[int]:
    """Return a process and all its descendants that are alive."""
    found = [pid]
    for one in found:
        try:
            tasks = list(Path(f"/proc/{one}/task").iterdir())
            found += [int(child) for task in tasks for child in (task / "children").read_text().split()]
        except OSError:  # it has just ended
            continue
    return found


def _high_water_mark(pid: int) -> float:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    lines = dict(line.split(":", 1) for line in status.splitlines())
    return int(lines["VmHWM"].split()[0]) / 1024 if "VmHWM" in lines else 0.0


def processor_time(pid: int) -> float:
    """Return the seconds of processor time that a process has taken; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def proxied(*words: str, descriptors: int | None = None) -> Iterator[Process]:
    """Run ``bcapscope proxy`` with options in front of a simulator; yield the proxy."""
    with simulator() as controller, proxy(controller.port, *words, descriptors=descriptors) as process:
        yield process


@contextmanager
def attacker(module: str, *words: object) -> Iterator[None]:
    """Run the ``attack`` of a module in a process of its own, which prints a line once it is under way."""
    argv = [sys.executable, "-m", module, "attack", *map(str, words)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline(), "the attacker did not start"
            yield
            assert process.poll() is None, "the attacker gave up"
        finally:
            process.kill()


def allow_descriptors(count: int) -> int:
    """Let this process open `count` files if the system does; return how many it may open."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = count if hard == resource.RLIM_INFINITY else min(count, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    return most


@dataclass(frozen=True)
class Ended:
    """A command that ran to its end.

    Attributes:
        code: its exit code.
        out: what it printed; the first megabyte.
        err: likewise for stderr.
        peak: MB; the most that it or a process that it started held.
        seconds: how long it ran.
    """

    code: int
    out: bytes
    err: str
    peak: float
    seconds: float


# The peak that the system accounts for a process counts from its fork on, when it still shared the memory
# of its parent. The launcher is small, so a parent that is large does not count.
_LAUNCHER = """
import os, resource, subprocess, sys
account = int(sys.argv[1])
os.set_inheritable(account, False)
code = subprocess.call(sys.argv[2:])
os.write(account, b"%d" % resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code if code >= 0 else 128 - code)
"""


def run_measured(words: Sequence[str | Path], stdin: Path | None = None, patience: float = PATIENCE) -> Ended:
    """Run ``bcapscope`` with `words` to its end.

    Raises:
        AssertionError: it ran longer than `patience` seconds, or printed a traceback.
    """
    argv = [sys.executable, "-m", "bcapscope", *map(str, words)]
    began = time.monotonic()
    peak_read, peak_write = os.pipe()
    with open(stdin or os.devnull, "rb") as source, open(peak_write, "wb") as account:
        process = subprocess.Popen(
            [sys.executable, "-S", "-c", _LAUNCHER, str(peak_write), *argv],
            stdin=source,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=(account.fileno(),),
            start_new_session=True,
        )
    watch = MemoryWatch(process.pid)
    outputs: dict[str, bytes] = {}
    readers = [
        threading.Thread(target=_drain, args=(name, pipe, outputs), daemon=True)
        for name, pipe in (("out", process.stdout), ("err", process.stderr))
    ]
    for reader in readers:
        reader.start()
    try:
        code = process.wait(patience)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise AssertionError(f"still running after {patience:.0f} s: {argv[2:]}") from None
    finally:
        watch.close()
        for reader in readers:
            reader.join(PATIENCE)
        with open(peak_read, "rb") as accounted:
            peak = int(accounted.read() or b"0") / 1024
    err = outputs["err"].decode(errors="replace")
    assert "Traceback" not in err, err[-3000:]
    return Ended(code, outputs["out"], err, max(peak, watch.peak), time.monotonic() - began)


def _drain(name: str, pipe: IO[bytes] | None, outputs: dict[str, bytes]) -> None:
    kept = bytearray()
    assert pipe is not None
    with pipe:
        while data := pipe.read(65536):
            kept += data[: max(0, 1_000_000 - len(kept))]
    outputs[name] = bytes(kept)


@dataclass(frozen=True)
class Outcome:
    """One attack on one command."""

    name: str
    quiet: RoundTrips
    attacked: RoundTrips
    halt: dict[str, float]
    """Seconds until Robot_Halt of a new client was answered, by transport."""
    peak: float
    """MB."""
    busy: float = 0.0
    """Share of one processor that the command took during the attack."""

    @property
    def ratio(self) -> float:
        """The honest client's p99 under attack, relative to that without."""
        return self.attacked.p99 / self.quiet.p99

    @property
    def line(self) -> str:
        """One line for a person."""
        halts = ", ".join(f"{transport} {seconds * 1e3:.0f} ms" for transport, seconds in self.halt.items())
        return (
            f"{self.name}: p99 {self.quiet.p99 * 1e3:.2f} -> {self.attacked.p99 * 1e3:.2f} ms "
            f"(x{self.ratio:.1f}), longest {self.attacked.longest * 1e3:.0f} ms; "
            f"Robot_Halt {halts}; {self.peak:.0f} MB; {self.busy:.0%} of a processor"
        )

    def check(self) -> None:
        """Raise an AssertionError if a limit was exceeded."""
        assert self.peak < MEMORY_LIMIT, self.line
        assert all(seconds < HALT_LIMIT for seconds in self.halt.values()), self.line


def under_attack(
    name: str,
    server: AbstractContextManager[Process],
    attack: Callable[[int], AbstractContextManager[object]],
    *,
    seconds: float = 5.0,
    transport: str = "tcp",
    halts: Sequence[str] = TRANSPORTS,
    code: int = 0,
) -> Outcome:
    """Measure an honest client without and with an attack, and Robot_Halt during the attack.

    Args:
        name: of the attack.
        server: runs the command; see `tests.cli.proxying`.
        attack: takes the port; the attack lasts as long as its block.
        seconds: how long the honest client is measured, each time.
        transport: of the honest client, which connects before the attack begins.
        halts: transports over which new clients send Robot_Halt during the attack.
        code: exit code of the command when it is interrupted after the attack.

    Raises:
        AssertionError: a limit was exceeded, the honest client failed, or the command ended badly.
    """
    with server as process, _watched(process.popen.pid) as memory:
        client = HonestClient(process.port, transport)
        try:
            quiet = client.measure(seconds)
            with attack(process.port):
                before, began = processor_time(process.popen.pid), time.monotonic()
                attacked = client.measure(seconds)
                busy = (processor_time(process.popen.pid) - before) / (time.monotonic() - began)
                halt = {each: halt_delay(process.port, each) for each in halts}
            memory.sample()
        finally:
            client.close()
        err = process.end(signal.SIGINT, code)
    assert "Traceback" not in err, err[-3000:]
    outcome = Outcome(name, quiet, attacked, halt, memory.peak, busy)
    print(outcome.line, flush=True)
    outcome.check()
    return outcome


@contextmanager
def _watched(pid: int) -> Iterator[MemoryWatch]:
    watch = MemoryWatch(pid)
    try:
        yield watch
    finally:
        watch.close()
