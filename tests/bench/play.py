"""How late set points go out beside two busy processes, and how late an empty loop is in the same run.

The empty loop sleeps and spins to its deadlines as the player does, and sends nothing; of the system it asks
real-time priority where that is measured, and nothing else. Both take turns, in short rounds, so that what
the host of a virtual machine takes away meets both alike; the medians of the rounds are shown. Run from the
project's root as ``python -m tests.bench.play``; real-time priority is shown where the system gives it.

A controller is another machine and never takes the player's processor, but the simulator does: each set point
wakes it, and when it has answered the system may go on with a busy process. With ``--apart`` it keeps to the
last processor, player and empty loop to the first, and each has a busy process on its own.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from math import cos, pi
from statistics import median
from typing import NamedTuple

import msgspec

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.player.blocking_caller import Channel
from bcapscope.player.lateness import Lateness, Spread
from bcapscope.player.player_messages import PlayerQuestion, PlayOutcome, PlayPlan, SlaveModePacing
from bcapscope.player.player_process import PlayerProcess
from bcapscope.player.realtime import realtime_priority
from tests.bench.jobs import ROOT

BUSY = 2
PERIODS = (8_000_000, 1_000_000)
LIMIT_P999, LIMIT_MOST = 100_000, 1_000_000
_HOME = (0.0, 90.0, 0.0, 90.0, 0.0)


@contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[str]]:
    """Run a Python process for the length of a block."""
    argv = [sys.executable, *words]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


def keep_to(pid: int, processor: int) -> None:
    """Let a process have one processor only, counted from the first, or with -1 from the last."""
    os.sched_setaffinity(pid, {sorted(os.sched_getaffinity(1))[processor]})


@contextmanager
def simulator(apart: bool = False) -> Iterator[ControllerTarget]:
    """Run the simulator, on the last processor only if it is to be `apart`; yield how to reach it."""
    with running("-m", "bcapscope", "sim", "--port", "0", "-q") as process:
        if apart:
            keep_to(process.pid, -1)
        assert process.stderr is not None
        match = re.search(r"port (\d+)", process.stderr.readline())
        if not match:
            raise SystemExit("the simulator did not start")
        # TCP, since the simulator, which is no other machine here, may be held up for longer than UDP bears.
        yield ControllerTarget("127.0.0.1", int(match[1]), tcp=True)


def empty_loop(period: int, count: int, realtime: bool) -> Spread:
    """Keep deadlines without sending anything, in a process of its own."""
    words = ["-m", "tests.bench.play", "--empty", str(period), str(count), str(int(realtime))]
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, check=True)
    return msgspec.json.decode(done.stdout, type=Spread)


def empty(period: int, count: int, realtime: bool) -> None:
    """Be that process."""
    late = Lateness(count)
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    channel = Channel(ends[0])
    with realtime_priority() if realtime else nullcontext():
        due = channel.now()
        for _ in range(count):
            due += period
            channel.wait_until(due)
            now = channel.now()
            late.add(now - due)
            if now - due > period // 2:
                due = now
    sys.stdout.buffer.write(msgspec.json.encode(late.exact_spread()))


def wave(target: ControllerTarget, period: int, count: int, realtime: bool) -> PlayPlan:
    """Make a slow wave of one axis."""
    # So slow that no limit is exceeded where the simulator, which gets no priority, misses some.
    points = [(0.2 * (1 - cos(2 * pi * number / count)), *_HOME) for number in range(count)]
    return PlayPlan(
        target=target, mode=SlaveModePacing.ASYNC, period=period, points=points, realtime=realtime
    )


def has_priority() -> bool:
    """Tell whether the system gives real-time priority."""
    with realtime_priority() as grade:
        return grade.realtime


def play(plan: PlayPlan) -> Spread:
    """Play; return the lateness.

    Raises:
        SystemExit: it did not get to the end.
    """
    with PlayerProcess(plan) as player:
        while player.ended is None:
            for message in player.wait_for_messages(1.0):
                if isinstance(message, PlayerQuestion):
                    player.answer("yes")
    ended = player.ended
    if ended.outcome is not PlayOutcome.DONE:
        raise SystemExit(f"{ended.outcome}: {ended.reason}")
    return ended.lateness


class Round(NamedTuple):
    """One measurement.

    Attributes:
        spread: lateness, ns.
        stolen: seconds that the host took away meanwhile, of all processors.
    """

    spread: Spread
    stolen: float


def measured(measure: Callable[[], Spread]) -> Round:
    """Measure, and watch the host meanwhile."""
    before = stolen()
    return Round(measure(), stolen() - before)


def line(name: str, rounds: list[Round]) -> str:
    """Write a line of the table: medians of the rounds and the greatest of all, µs; what was stolen, ms."""
    fields = ("p50", "p99", "p999", "most")
    middles = [median(getattr(each.spread, field) for each in rounds) for field in fields]
    most = max(each.spread.most for each in rounds)
    stolen = sum(each.stolen for each in rounds) * 1000
    return f"{name:38}" + "".join(f"{point / 1000:10.1f}" for point in (*middles, most)) + f"{stolen:10.0f}"


HEAD = " " * 38 + "".join(f"{title:>10}" for title in ("p50", "p99", "p99.9", "max", "greatest", "stolen"))


def options(doc: str | None, seconds: float, rounds: int) -> argparse.ArgumentParser:
    """Make the command line: how long, and how often unless told."""
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=seconds, help="of each measurement")
    parser.add_argument("--rounds", type=int, default=rounds)
    return parser


def main() -> None:
    """Measure and print."""
    parser = options(__doc__, seconds=2.0, rounds=5)
    parser.add_argument("--apart", action="store_true", help="the simulator on a processor of its own")
    parser.add_argument("--empty", nargs=3, type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.empty:
        empty(chosen.empty[0], chosen.empty[1], bool(chosen.empty[2]))
        return
    print(
        f"{os.cpu_count()} processors, {BUSY} busy processes beside; {chosen.rounds} rounds of "
        f"{chosen.seconds:g} s in turns; lateness in µs, medians of the rounds and the greatest of all; ms "
        "that the host took from all processors"
    )
    print(HEAD)
    with ExitStack() as stack:
        target = stack.enter_context(simulator(chosen.apart))
        for number in range(BUSY):
            busy = stack.enter_context(running("-c", "while True: pass"))
            if chosen.apart:
                keep_to(busy.pid, -number)
        if chosen.apart:
            keep_to(0, 0)  # and so do player and loop, which we start
        grades = (True, False) if has_priority() else (False,)
        for period in PERIODS:
            for wanted in grades:
                _measure(target, period, round(chosen.seconds * 1e9 / period), chosen.rounds, wanted)


def _measure(target: ControllerTarget, period: int, count: int, rounds: int, wanted: bool) -> None:
    bare: list[Round] = []
    ours: list[Round] = []
    plan = wave(target, period, count, wanted)
    for _ in range(rounds):
        bare.append(measured(lambda: empty_loop(period, count, wanted)))
        ours.append(measured(lambda: play(plan)))
    name = f"{period / 1e6:g} ms, {'real-time priority' if wanted else 'without'}"
    print(line(f"{name}, empty loop", bare))
    print(line(f"{name}, play", ours), flush=True)
    if wanted:
        good = [f"{sum(map(_is_good, found))} of {len(found)} rounds" for found in (ours, bare)]
        print(f"    p99.9 under 0.1 ms and none above 1 ms: {good[0]}; the empty loop: {good[1]}")
    else:
        shares = [median(each.spread.p999 for each in found) for found in (ours, bare)]
        print(f"    p99.9 {shares[0] / max(1, shares[1]):.2f} times that of the empty loop")


def _is_good(found: Round) -> bool:
    """Tell whether a round keeps the limits; no priority helps against a host that takes the processor."""
    return found.spread.p999 < LIMIT_P999 and found.spread.most <= LIMIT_MOST


def stolen() -> float:
    """Return the seconds that the host gave to other machines, against which no priority in here helps."""
    with open("/proc/stat", encoding="ascii") as file:
        return int(file.readline().split()[8]) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
