"""Round trips to a server in a process of its own: how many a second, and how long the slow ones take.

Server and client have a processor each, as on two machines, or share one; left to the system they would move
from one to the other, and the same run would be two different ones.
"""

from __future__ import annotations

import argparse
import gc
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from statistics import median
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.hresult import hresult_name
from tests.bench.awake import add_option, awake
from tests.bench.jobs import ROOT, python

TRANSPORTS = ("udp", "tcp")
SERVICE_START, CONNECT, GET_ROBOT, GET_VARIABLE, EXECUTE, GET_VALUE = 1, 3, 7, 9, 64, 101
J_MODE_1 = 0x102
"""Slave mode in which every slvMove is answered at once."""


class Trips(NamedTuple):
    """Round trips a second, and how long they took in µs."""

    rate: float
    p50: float
    p99: float
    p999: float


class Job(NamedTuple):
    """Something to time.

    Attributes:
        name: what the table calls it.
        transport: `udp` or `tcp`.
        run: makes so many round trips and returns the ns that each took.
    """

    name: str
    transport: str
    run: Callable[[int], list[int]]


Figures: TypeAlias = "Mapping[tuple[str, str], Trips]"
"""Medians by name and transport."""


@contextmanager
def server(argv: Sequence[str], pattern: str) -> Iterator[int]:
    """Run a server for the length of a block; `pattern` finds its port in the first line that it prints."""
    process = subprocess.Popen(
        argv, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        found = re.search(pattern, line)
        if found is None:
            raise SystemExit(f"{' '.join(argv)} says: {line}")
        place(process.pid, 1)
        yield int(found[1])
    finally:
        process.terminate()
        process.communicate(timeout=10)


def echo(transport: str) -> list[str]:
    """Return the command of the bare echo server; its port is all it prints."""
    return list(python("tests.bench.echo", transport))


def simulator(*options: str) -> list[str]:
    """Return the command of the simulator without the log, or with the log thrown away."""
    return ["sh", "-c", 'exec "$@" >/dev/null', "sh", *python("bcapscope", "sim", "--port", "0", *options)]


ECHO_PORT, SIMULATOR_PORT = r"^(\d+)", r"port (\d+)"


def place(process: int, part: int) -> None:
    """Bind a process to one of the processors chosen; 0 is this one."""
    if CPUS:
        os.sched_setaffinity(process, {CPUS[min(part, len(CPUS) - 1)]})


CPUS: list[int] = []
"""Processors of client and server; none where the system cannot bind a process."""


class Line:
    """A socket, and calls over it without retries."""

    def __init__(self, transport: str, port: int) -> None:
        kind = socket.SOCK_DGRAM if transport == "udp" else socket.SOCK_STREAM
        self.socket = socket.socket(socket.AF_INET, kind)
        self.socket.connect(("127.0.0.1", port))
        if transport == "tcp":
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.serial = 0

    def request(self, function_id: int, *arguments: Variant) -> bytes:
        """Make the next request."""
        self.serial = self.serial % 65535 + 1
        return encode_frame(self.serial, 0, function_id, arguments)

    def call(self, function_id: int, *arguments: Variant) -> Variant:
        """Make a call; return its result, EMPTY where there is none."""
        self.socket.send(self.request(function_id, *arguments))
        reply = Frame(self.socket.recv(4096))
        if reply.code:
            raise SystemExit(f"function {function_id} is answered {hresult_name(reply.code)}")
        return reply.arguments[0].variant if reply.arguments else EMPTY

    def trips(self, requests: Iterable[bytes], answered: bool = True) -> list[int]:
        """Send each request when the one before is answered; return the ns that each took."""
        send, receive, clock = self.socket.send, self.socket.recv, time.perf_counter_ns
        took, replies = [], []
        for request in requests:
            began = clock()
            send(request)
            reply = receive(4096)
            took.append(clock() - began)
            replies.append(reply)
        bad = [reply for reply in replies if answered and Frame(reply).code]
        if bad:
            raise SystemExit(f"{len(bad)} of {len(took)} calls were refused, not timed")
        return took


def bstr(text: str) -> Variant:
    """Make a VT_BSTR."""
    return Variant(VT.BSTR, text)


class Arm:
    """A robot in slave mode, and a variable, at the other end of a line.

    Attributes:
        robot: its handle.
        variable: handle of I1.
        joints: where it stands.
    """

    def __init__(self, line: Line) -> None:
        line.call(SERVICE_START, bstr(""))
        controller = line.call(CONNECT, *map(bstr, ("", "CaoProv.DENSO.VRC", "localhost", "")))
        self.robot = line.call(GET_ROBOT, controller, bstr("Arm"), bstr(""))
        self.variable = line.call(GET_VARIABLE, controller, bstr("I1"), bstr(""))
        line.call(EXECUTE, self.robot, bstr("TakeArm"), EMPTY)
        line.call(EXECUTE, self.robot, bstr("Motor"), Variant(VT.I4, 1))
        self.joints = line.call(EXECUTE, self.robot, bstr("CurJnt"), EMPTY).value
        line.call(EXECUTE, self.robot, bstr("slvChangeMode"), Variant(VT.I4, J_MODE_1))


def points(joints: object, count: int) -> Iterator[Variant]:
    """Yield set points, each a little further than the one before."""
    assert isinstance(joints, tuple)
    first, *others = joints
    for number in range(count):
        yield Variant.array(VT.R8, (first + number * 1e-7, *others))


def summary(took: Sequence[int]) -> Trips:
    """Return rate and percentiles of round trips of so many ns."""
    ordered = sorted(took)
    count = len(ordered)
    slow = (ordered[count * share // 1000] / 1e3 for share in (500, 990, 999))
    return Trips(count / sum(ordered) * 1e9, *slow)


def measure(jobs: Sequence[Job], rounds: int, count: int) -> dict[tuple[str, str], Trips]:
    """Run every job once a round; return the medians."""
    found: dict[tuple[str, str], list[Trips]] = {(job.name, job.transport): [] for job in jobs}
    for number in range(1, rounds + 1):
        for job in jobs:
            print(f"round {number} of {rounds}: {job.name}, {job.transport}", file=sys.stderr)
            found[job.name, job.transport].append(summary(job.run(count)))
    return {key: Trips(*map(median, zip(*each, strict=True))) for key, each in found.items()}


def table(figures: Figures) -> Iterator[str]:
    """Yield the lines of the table of medians."""
    yield f"{'µs a round trip':36}{'':5}{'trips/s':>9}{'p50':>8}{'p99':>8}{'p99.9':>8}"
    for (name, transport), each in figures.items():
        yield f"{name:36}{transport:5}{each.rate:9,.0f}{each.p50:8.1f}{each.p99:8.1f}{each.p999:8.1f}"


def main(doc: str | None, jobs: Sequence[Job], told: Callable[[Figures], Iterable[str]]) -> None:
    """Run a benchmark as the command line asks.

    Args:
        doc: its module's docstring, of which the first line is shown as help.
        jobs: what to time.
        told: makes of the figures what stands under the table.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0] if doc else None)
    parser.add_argument("--runs", type=int, default=5, help="rounds, of which the medians are shown")
    parser.add_argument("--trips", type=int, default=20_000, help="round trips of each job and round")
    parser.add_argument("--share", action="store_true", help="one processor for server and client")
    add_option(parser)
    parser.add_argument("--only", default="", help="run the jobs whose name contains this")
    chosen = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        CPUS[:] = sorted(os.sched_getaffinity(0))[: 1 if chosen.share else 2]
    gc.disable()
    with awake(chosen.awake):
        place(0, 0)
        figures = measure([job for job in jobs if chosen.only in job.name], chosen.runs, chosen.trips)
    for line in (*table(figures), *told(figures)):
        print(line)
