"""Hours of ordinary traffic: clients that come and stay, a recording proxy with a rule, and a simulator.

Run from the project's root as ``python -m tests.fuzz.soak SECONDS``. Fails if the memory of a process grows,
a call is not answered, or a file stays open.
"""

from __future__ import annotations

import asyncio
import os
import signal
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from bcapscope.client import Robot, connect, over_tcp, over_udp
from tests.cli.proxying import Process, proxy, simulator

PERIOD = 0.008
"""Seconds from one call of a client that stays to its next."""

SAMPLES = 60
"""Looks at the memory, evenly spread."""

MAX_GROWTH = 4.0
"""MB by which the memory of a process may differ from its second quarter to its last."""


@dataclass
class Watched:
    """A process whose memory and open files are measured.

    Attributes:
        name: for people.
        pid: its number.
        memory: MB that only this process has, at each look.
        files: that were open at each look.
    """

    name: str
    pid: int
    memory: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)

    def look(self) -> None:
        """Take a sample."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        (line,) = (line for line in status.splitlines() if line.startswith("RssAnon:"))
        self.memory.append(int(line.split()[1]) / 1024)
        self.files.append(len(os.listdir(f"/proc/{self.pid}/fd")))

    def grown(self) -> float:
        """Return MB from the second quarter to the last; what is kept at first is kept by then."""
        quarter = max(1, len(self.memory) // 4)
        return statistics.median(self.memory[-quarter:]) - statistics.median(
            self.memory[quarter : 2 * quarter]
        )

    def more_files(self) -> int:
        """Return by how much the fewest open files of the last quarter exceed the most of the first half."""
        quarter = max(1, len(self.files) // 4)
        return min(self.files[-quarter:]) - max(self.files[: 2 * quarter])


@dataclass
class Figures:
    """What the clients met: calls that were answered, the longest (s), and clients that came and went."""

    calls: int = 0
    longest: float = 0.0
    visits: int = 0


def family(process: Process) -> list[int]:
    """Return the pids of a command and its children."""
    pid = process.popen.pid
    return [pid, *map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())]


async def ask(robot: Robot, figures: Figures) -> None:
    """Ask where the robot stands."""
    began = time.perf_counter()
    position = await robot.execute("CurJnt")
    assert isinstance(position, tuple)
    figures.calls += 1
    figures.longest = max(figures.longest, time.perf_counter() - began)


async def stay(port: int, tcp: bool, until: float, figures: Figures) -> None:
    """Be a client that stays: 125 calls a second."""
    opener = (over_tcp if tcp else over_udp)("127.0.0.1", port)
    async with connect(opener) as service:
        robot = await (await service.connect("", "CaoProv.DENSO.VRC", "localhost")).get_robot("Arm")
        while time.monotonic() < until:
            await ask(robot, figures)
            await asyncio.sleep(PERIOD)


async def come_and_go(port: int, until: float, figures: Figures) -> None:
    """Be a new client each second, over both transports in turn."""
    while time.monotonic() < until:
        await stay(port, bool(figures.visits % 2), time.monotonic() + 0.1, figures)
        figures.visits += 1
        await asyncio.sleep(1)


async def watch(watched: list[Watched], until: float, seconds: float, figures: Figures) -> None:
    """Measure and show, `SAMPLES` times in all."""
    while time.monotonic() < until:
        for each in watched:
            each.look()
        memory = ", ".join(f"{each.name} {each.memory[-1]:.1f} MB" for each in watched)
        print(
            f"{seconds - until + time.monotonic():6.0f} s {figures.calls} calls, the longest "
            f"{figures.longest * 1e3:.0f} ms, {figures.visits} visits; {memory}",
            flush=True,
        )
        await asyncio.sleep(seconds / SAMPLES)


async def traffic(port: int, watched: list[Watched], seconds: float) -> None:
    """Run all clients for so many seconds."""
    figures, until = Figures(), time.monotonic() + seconds
    async with asyncio.TaskGroup() as group:
        for tcp in (False, True):
            group.create_task(stay(port, tcp, until, figures))
        group.create_task(come_and_go(port, until, figures))
        group.create_task(watch(watched, until, seconds, figures))


def soak(seconds: float) -> list[str]:
    """Run it all; return what is wrong, a sentence each."""
    with tempfile.TemporaryDirectory() as folder, simulator() as server:
        ring = ("--record", f"{folder}/soak.pcapng", "--ring", "3x1MB")
        words = ("-q", "--forget", "5", "--fault", "delay=1ms 10% if command == CurJnt")
        with proxy(server.port, *words, *ring) as relay:
            places = [("sim", family(server)), ("proxy", family(relay)), ("clients", [os.getpid()])]
            watched = [
                Watched(f"{name} {number}", pid)
                for name, pids in places
                for number, pid in enumerate(pids, 1)
            ]
            asyncio.run(traffic(relay.port, watched, seconds))
            print(relay.end(signal.SIGINT)[-1000:])
        files = list(Path(folder).glob("*.pcapng"))
        wrong = [
            f"{each.name} has grown by {each.grown():.1f} MB" for each in watched if each.grown() > MAX_GROWTH
        ]
        wrong += [
            f"{each.name} has {each.more_files()} more files open"
            for each in watched
            if each.more_files() > 0
        ]
        if not 1 <= len(files) <= 3:
            wrong.append(f"{len(files)} files are in a ring of 3")
    return wrong


def main() -> int:
    """Soak for so many seconds; return 1 if something is wrong."""
    wrong = soak(float(sys.argv[1]))
    print("\n".join(wrong) or "memory and open files stay the same")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
