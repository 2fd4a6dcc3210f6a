"""The screen under load: first rows, key press to redraw, jumps, resizing, memory.

Runs ``bcapscope tui`` in terminals of its own and looks at what it draws there. Wants: first rows within 1 s,
99 of 100 keys within 50 ms, a jump or a resize within 100 ms, less than 300 MB for a million frames. Run as
``python -m tests.bench.screen``.
"""

from __future__ import annotations

import argparse
import random
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from tests.bench.jobs import generate
from tests.bench.terminal import ROOT, Terminal
from tests.bench.traffic import Session

DOWN, UP, HOME, END, QUIT = b"\x1b[B", b"\x1b[A", b"\x1b[H", b"\x1b[F", b"\x11"
GO_TO = b"\x07"
SIZES = ((80, 24), (200, 50))
LIVE_RATE = 2000
_HEADER = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262144, 1)


REALTIME = ("chrt", "--reset-on-fork", "--fifo", "30")
"""Before the command on a machine that others use: its own processes are as they would be, only the screen's
goes before those of others."""


def command(path: Path) -> list[str]:
    """Return the command that shows a finished capture."""
    return [sys.executable, "-m", "bcapscope", "tui", str(path)]


def quantiles(seconds: list[float]) -> str:
    """Write the median, the 99th percentile and the largest, in milliseconds."""
    ordered = sorted(seconds)
    p99 = ordered[min(len(ordered) - 1, round(len(ordered) * 0.99))]
    median, most = ordered[len(ordered) // 2], ordered[-1]
    return f"median {median * 1e3:5.1f}  p99 {p99 * 1e3:5.1f}  max {most * 1e3:5.1f} ms"


def keys(terminal: Terminal, first: int, count: int, pause: Callable[[], float]) -> list[float]:
    """Press Down so many times from the frame `first` on, and measure until the next frame is told of."""
    taken = []
    for number in range(first + 1, first + count + 1):
        terminal.rest(pause())
        began = time.perf_counter()
        terminal.press(DOWN)
        taken.append(terminal.until(f"Frame {number},", f"Frame {number} ") - began)
    return taken


def go_to(terminal: Terminal, number: int) -> float:
    """Jump to a frame by its number and return how long that takes from Enter on."""
    terminal.press(GO_TO)
    terminal.until("12.5s")
    terminal.press(str(number).encode())
    terminal.rest(0.2)
    began = time.perf_counter()
    terminal.press(b"\r")
    return terminal.until(f"Frame {number},", f"Frame {number} ") - began


def resizes(terminal: Terminal, columns: int, rows: int, count: int) -> list[float]:
    """Change the size back and forth."""
    taken = []
    for turn in range(count):
        wide = columns + 10 * (turn % 2 == 0)
        began = time.perf_counter()
        terminal.resize(wide, rows)
        taken.append(terminal.until("No.") - began)
        terminal.rest(0.3)
    return taken


def search(terminal: Terminal) -> dict[str, float]:
    """Search all frames for what none of them has, and return the most memory that took, MB by process."""
    terminal.press(b"/")
    terminal.rest(0.5)
    terminal.press(b"length > 16777215\r")
    terminal.until("%")
    most: dict[str, float] = {}
    while b"%" in terminal.seen():  # how far it has come is drawn again and again
        most = max(most, terminal.megabytes(), key=lambda found: sum(found.values()))
        terminal.press(b"")
        terminal.rest(1.0)
    return most


def memory(sizes: dict[str, float]) -> str:
    """Write the memory of all processes together, and of each."""
    return f"{sum(sizes.values()):.0f} MB: {', '.join(f'{name} {size:.0f}' for name, size in sizes.items())}"


def a_file(path: Path, frames: int, presses: int, prefix: tuple[str, ...]) -> None:
    """Measure a capture while it is being read and afterwards."""
    pause = random.Random(1).uniform
    for columns, rows in SIZES:
        with Terminal([*prefix, *command(path)], columns, rows) as terminal:
            first = terminal.until("Service_Start") - terminal.began
            print(f"\n{frames:,} frames, {columns} x {rows}: first rows after {first:.2f} s")
            terminal.rest(1.0)
            taken = keys(terminal, 1, presses, lambda: pause(0.01, 0.06))
            print(f"  key while reading    {quantiles(taken)}")
            began = time.perf_counter()
            terminal.press(END)
            terminal.until("Frame ")
            print(f"  End while reading    {(time.perf_counter() - began) * 1e3:.1f} ms")
            most: dict[str, float] = {}
            while True:
                most = max(most, terminal.megabytes(), key=lambda found: sum(found.values()))
                terminal.press(END)
                terminal.rest(1.0)
                terminal.press(HOME)
                terminal.rest(0.2)
                terminal.press(END)
                terminal.rest(0.3)
                if f"Frame {frames:d}".encode() in terminal.seen():
                    break
            print(f"  read to the end after {time.perf_counter() - terminal.began:.1f} s")
            terminal.press(HOME)
            terminal.rest(0.5)
            print(
                f"  key, all read        {quantiles(keys(terminal, 1, presses, lambda: pause(0.01, 0.06)))}"
            )
            places = random.Random(2).sample(range(1, frames), 20)
            print(f"  jump                 {quantiles([go_to(terminal, place) for place in places])}")
            print(f"  resize               {quantiles(resizes(terminal, columns, rows, 20))}")
            began = time.perf_counter()
            sizes = search(terminal)
            print(f"  searched all after   {time.perf_counter() - began:.1f} s")
            print(f"  memory while reading {memory(most)}")
            print(f"  memory, searching    {memory(sizes)}")


@contextmanager
def growing(path: Path) -> Iterator[None]:
    """Let a new capture grow by 2,000 frames a second for the length of a block."""
    path.write_bytes(_HEADER)
    writer = subprocess.Popen(
        [sys.executable, "-m", "tests.bench.screen", "--grow", str(path)], cwd=ROOT, stdin=subprocess.PIPE
    )
    try:
        yield
    finally:
        writer.kill()
        writer.communicate()


def live(folder: Path, presses: int, prefix: tuple[str, ...]) -> None:
    """Measure while a capture grows by 2,000 frames a second, with the cursor on its last line and above."""
    path = folder / "growing.pcap"
    pause = random.Random(3).uniform
    argv = [*prefix, sys.executable, "-m", "tests.bench.screen", "--follow", str(path)]
    with growing(path), Terminal(argv, 160, 48) as terminal:
        terminal.until("Frame ")
        terminal.rest(2.0)
        terminal.press(HOME)
        terminal.until("Service_Start")
        terminal.rest(0.5)
        print(f"\nlive, {LIVE_RATE} frames/s, 160 x 48")
        print(f"  key                  {quantiles(keys(terminal, 1, presses, lambda: pause(0.01, 0.06)))}")
        print(f"  resize               {quantiles(resizes(terminal, 160, 48, 10))}")
        print(f"  memory {sum(terminal.megabytes().values()):.0f} MB")


def grow(path: Path) -> None:
    """Append frames to a capture at the rate of live traffic, for ever."""
    records = Session().records()
    with path.open("ab", buffering=0) as file:
        began, written = time.monotonic(), 0
        while True:
            due = int((time.monotonic() - began) * LIVE_RATE) - written
            file.write(b"".join(islice(records, due)))
            written += due
            time.sleep(0.01)


def follow(path: Path) -> None:
    """Show a capture that grows."""
    feed = TrafficFeed(ReadJob(path=str(path), follow=True))
    settings = path.with_name("screen.yaml")
    BcapApp([ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, path.name))], settings).run()
    feed.close()


def main() -> None:
    """Measure as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames of the capture")
    parser.add_argument("--presses", type=int, default=300, help="keys of each measurement")
    parser.add_argument("--capture", type=Path, help="a capture of that many frames, instead of a new one")
    parser.add_argument("--only", choices=["file", "live"], help="measure only this")
    parser.add_argument("--realtime", action="store_true", help="on a busy machine: the screen before others")
    parser.add_argument("--grow", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--follow", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.grow or chosen.follow:
        (grow if chosen.grow else follow)(chosen.grow or chosen.follow)
        return
    prefix = REALTIME if chosen.realtime else ()
    with tempfile.TemporaryDirectory(prefix="bcap-bench-") as name:
        if chosen.only != "live":
            path = chosen.capture or generate(Path(name), chosen.frames)
            a_file(path, chosen.frames, chosen.presses, prefix)
        if chosen.only != "file":
            live(Path(name), chosen.presses, prefix)


if __name__ == "__main__":
    main()
