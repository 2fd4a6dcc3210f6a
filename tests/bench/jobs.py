"""Commands that are timed beside each other: seconds, processor seconds, peak memory.

Every job runs once a round, so that a slow moment of the machine meets all of them; the medians of the
rounds are shown. Each job's output on a thousand frames is looked at first: what leaves something out is not
timed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple, TypeAlias

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
CHECK_FRAMES = 1_000


class Job(NamedTuple):
    """One command on one capture.

    Attributes:
        name: what the table calls it.
        frames: how many frames the capture holds.
        command: the arguments; ``{}`` stands for the capture.
        mark: bytes that its output is known by, empty where nothing can be known by them.
        marks: how often they are in its output on the small capture.
    """

    name: str
    frames: int
    command: tuple[str, ...]
    mark: bytes = b""
    marks: int = CHECK_FRAMES

    def argv(self, capture: Path) -> list[str]:
        """Return the command line for `capture`."""
        return [str(capture) if word == "{}" else word for word in self.command]


class Run(NamedTuple):
    """What one run took: elapsed and processor seconds, peak resident memory in MB (10^6 bytes)."""

    seconds: float
    processor: float
    megabytes: float


Figures: TypeAlias = "Mapping[Job, Run]"


def python(module: str, *words: str) -> tuple[str, ...]:
    """Return the command that runs a module with this Python."""
    return (sys.executable, "-m", module, *words)


def tshark(*words: str) -> tuple[str, ...]:
    """Return the command that lets tshark read the capture."""
    return ("tshark", *words, "-r", "{}")


def possible(jobs: Iterable[Job]) -> list[Job]:
    """Leave out what has no frames, what is there twice, and tshark where it is not installed."""
    found = [job for job in dict.fromkeys(jobs) if job.frames]
    if not shutil.which("tshark"):
        print("tshark is not installed: its rows are left out")
        found = [job for job in found if job.command[0] != "tshark"]
    return found


def generate(folder: Path, frames: int) -> Path:
    """Write the capture from a process of its own: a child's peak memory starts at its parent's."""
    path = folder / f"{frames}.pcap"
    if not path.exists():
        argv = python("tests.bench.traffic", str(frames), str(path))
        subprocess.run(argv, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    return path


def check(job: Job, capture: Path) -> str:
    """Return what is wrong with the job's output on the small capture, nothing if all is there."""
    done = subprocess.run(job.argv(capture), check=False, cwd=ROOT, capture_output=True)
    if done.returncode:
        *_, last = done.stderr.decode(errors="replace").splitlines() or [""]
        return f"exit code {done.returncode} {last}".rstrip()
    seen = done.stdout.count(job.mark) if job.mark else job.marks
    return "" if seen == job.marks else f"prints {seen} of {job.marks} {job.mark!r}"


def run(job: Job, capture: Path) -> Run:
    """Run the job once with its output thrown away."""
    began = time.perf_counter()
    process = subprocess.Popen(
        job.argv(capture), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - began
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{job.name} failed with exit code {process.returncode}")
    return Run(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024 / 1e6)


def measure(wanted: Sequence[Job], folder: Path, rounds: int) -> dict[Job, Run]:
    """Return the medians of every job."""
    runs: dict[Job, list[Run]] = {job: [] for job in wanted}
    for number in range(1, rounds + 1):
        for job in wanted:
            print(f"round {number} of {rounds}: {job.name}, {job.frames:,} frames", file=sys.stderr)
            runs[job].append(run(job, generate(folder, job.frames)))
    return {job: Run(*map(median, zip(*found, strict=True))) for job, found in runs.items()}


def table(figures: Figures) -> Iterator[str]:
    """Yield the lines of the table of medians."""
    yield f"{'':30}{'frames':>12}{'s':>9}{'cpu s':>9}{'µs/frame':>10}{'peak MB':>9}"
    for job, found in figures.items():
        each = found.seconds / job.frames * 1e6
        yield (
            f"{job.name:30}{job.frames:12,}{found.seconds:9.2f}{found.processor:9.2f}"
            f"{each:10.2f}{found.megabytes:9.1f}"
        )


def ratios(figures: Figures, pairs: Iterable[tuple[str, str, int]]) -> Iterator[str]:
    """Yield how many times as fast as its peer each is: pairs of peer and ours, on so many frames."""
    of = {(job.name, job.frames): found for job, found in figures.items()}
    for peer, ours, count in pairs:
        if (peer, count) in of and (ours, count) in of:
            theirs, mine = of[peer, count], of[ours, count]
            ratio, busy = theirs.seconds / mine.seconds, theirs.processor / mine.processor
            yield f"{ours}: {ratio:.2f} (by cpu {busy:.2f}) times as fast as {peer}, {count:,} frames"


def memory(figures: Figures, name: str, frames: int, long_frames: int) -> Iterator[str]:
    """Yield what a job's memory does when the capture grows."""
    of = {(job.name, job.frames): found.megabytes for job, found in figures.items()}
    short, long = of.get((name, frames)), of.get((name, long_frames))
    if short and long:
        yield f"{name}: {short:.1f} MB for {frames:,}, {long:.1f} MB for {long_frames:,}"


def main(
    doc: str | None,
    jobs: Callable[[int, int], list[Job]],
    told: Callable[[Figures, int, int], Iterable[str]],
) -> None:
    """Run a benchmark as the command line asks.

    Args:
        doc: its module's docstring, of which the first line is shown as help.
        jobs: makes the jobs for so many frames, and so many more in a longer capture unless 0.
        told: makes of the figures what stands under the table.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0] if doc else None)
    parser.add_argument("--runs", type=int, default=5, help="rounds, of which the medians are shown")
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames of the main capture")
    parser.add_argument("--long", type=int, default=0, help="frames of a longer one, to compare memory")
    parser.add_argument("--only", default="", help="run the jobs whose name contains this")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bcap-bench-") as name:
        folder = Path(name)
        wanted = []
        for job in possible(jobs(chosen.frames, chosen.long)):
            if chosen.only not in job.name:
                continue
            if fault := check(job, generate(folder, CHECK_FRAMES)):
                print(f"{job.name}: {fault}, not timed")
            else:
                wanted.append(job)
        figures = measure(wanted, folder, chosen.runs)
        for line in (*table(figures), *told(figures, chosen.frames, chosen.long)):
            print(line)
