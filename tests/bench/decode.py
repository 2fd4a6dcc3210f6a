"""`bcapscope decode` beside its peers, all in one run: seconds, processor seconds, peak memory, ratios.

Peers are tshark with `bcap.lua`, tshark without any b-CAP, and the bare loops of `loops.py`. Every job runs
once a round, so that a slow moment of the machine meets all of them; the medians of the rounds are shown.
Each job's output on a thousand frames is counted first: what leaves frames out is not timed.
Run from the project's root as ``python -m tests.bench.decode``.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
JSON_FRAMES = 100_000
CHECK_FRAMES = 1_000


class Job(NamedTuple):
    """One command on one capture.

    Attributes:
        name: what the table calls it.
        frames: how many frames the capture holds.
        command: the arguments; ``{}`` stands for the capture.
        mark: bytes that its output has once a frame, empty where it prints nothing a frame.
    """

    name: str
    frames: int
    command: tuple[str, ...]
    mark: bytes

    def argv(self, capture: Path) -> list[str]:
        """Return the command line for `capture`."""
        return [str(capture) if word == "{}" else word for word in self.command]


class Run(NamedTuple):
    """What one run took: elapsed and processor seconds, peak resident memory in MB (10^6 bytes)."""

    seconds: float
    processor: float
    megabytes: float


def _python(module: str, *words: str) -> tuple[str, ...]:
    return (sys.executable, "-m", module, *words)


def _tshark(*words: str) -> tuple[str, ...]:
    return ("tshark", *words, "-r", "{}")


LUA = ("-X", f"lua_script:{HERE / 'bcap.lua'}")
PEER, ALONE, PEER_JSON = "tshark, b-CAP in Lua", "tshark, no b-CAP", "tshark -T json, b-CAP in Lua"
LINES, JSON = "bcapscope decode", "bcapscope decode --json"
HEADERS, ARGUMENTS = "bare loop over headers", "bare loop over all arguments"


def jobs(frames: int, long_frames: int) -> list[Job]:
    """List what to run: text on `frames`, JSON on that and 100,000, ours on `long_frames` too unless 0."""
    json = min(frames, JSON_FRAMES)
    decode = _python("bcapscope", "decode", "{}")
    found = [
        Job(HEADERS, frames, _python("tests.bench.loops", "headers", "{}"), b""),
        Job(ARGUMENTS, frames, _python("tests.bench.loops", "arguments", "{}"), b""),
        Job(PEER, frames, _tshark(*LUA), b" b-CAP "),
        Job(ALONE, frames, _tshark(), b"\n"),
        Job(PEER_JSON, json, _tshark(*LUA, "-T", "json"), b'"bcap.length"'),
        Job(LINES, frames, decode, b"\n"),
        Job(JSON, json, (*decode, "--json"), b"\n"),
        Job(JSON, frames, (*decode, "--json"), b"\n"),
        Job(LINES, long_frames, decode, b"\n"),
    ]
    if not shutil.which("tshark"):
        print("tshark is not installed: its rows are left out")
        found = [job for job in found if job.command[0] != "tshark"]
    return list(dict.fromkeys(job for job in found if job.frames))


def generate(folder: Path, frames: int) -> Path:
    """Write the capture from a process of its own: a child's peak memory starts at its parent's."""
    path = folder / f"{frames}.pcap"
    if not path.exists():
        argv = [sys.executable, "-m", "tests.bench.traffic", str(frames), str(path)]
        subprocess.run(argv, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    return path


def check(job: Job, capture: Path) -> str:
    """Return what is wrong with the job's output on the small capture, nothing if it names each frame."""
    done = subprocess.run(job.argv(capture), check=False, cwd=ROOT, capture_output=True)
    if done.returncode:
        *_, last = done.stderr.decode(errors="replace").splitlines() or [""]
        return f"exit code {done.returncode} {last}".rstrip()
    seen = done.stdout.count(job.mark) if job.mark else CHECK_FRAMES
    return "" if seen == CHECK_FRAMES else f"prints {seen} of {CHECK_FRAMES} frames"


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


def table(figures: dict[Job, Run]) -> Iterator[str]:
    """Yield the lines of the table of medians."""
    yield f"{'':30}{'frames':>12}{'s':>9}{'cpu s':>9}{'µs/frame':>10}{'peak MB':>9}"
    for job, found in figures.items():
        each = found.seconds / job.frames * 1e6
        yield (
            f"{job.name:30}{job.frames:12,}{found.seconds:9.2f}{found.processor:9.2f}"
            f"{each:10.2f}{found.megabytes:9.1f}"
        )


def ratios(figures: dict[Job, Run], frames: int, long_frames: int) -> Iterator[str]:
    """Yield how often each peer's time is ours, and what memory does when the capture grows."""
    of = {(job.name, job.frames): found for job, found in figures.items()}
    json = min(frames, JSON_FRAMES)
    pairs = [(PEER, LINES, frames), (ALONE, LINES, frames), (PEER_JSON, JSON, json)]
    pairs += [(ARGUMENTS, LINES, frames), (HEADERS, LINES, frames)]
    for peer, ours, count in pairs:
        if (peer, count) in of and (ours, count) in of:
            theirs, mine = of[peer, count], of[ours, count]
            ratio, busy = theirs.seconds / mine.seconds, theirs.processor / mine.processor
            yield f"{ours}: {ratio:.2f} (by cpu {busy:.2f}) times as fast as {peer}, {count:,} frames"
    short, long = of.get((LINES, frames)), of.get((LINES, long_frames))
    if short and long:
        yield f"{LINES}: {short.megabytes:.1f} MB for {frames:,}, {long.megabytes:.1f} MB for {long_frames:,}"


def main() -> None:
    """Run the benchmark as the command line asks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=5, help="rounds, of which the medians are shown")
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames of the main capture")
    parser.add_argument("--long", type=int, default=0, help="frames of a longer one, to compare memory")
    parser.add_argument("--only", default="", help="run the jobs whose name contains this")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bcap-bench-") as name:
        folder = Path(name)
        wanted = []
        for job in jobs(chosen.frames, chosen.long):
            if chosen.only not in job.name:
                continue
            if fault := check(job, generate(folder, CHECK_FRAMES)):
                print(f"{job.name}: {fault}, not timed")
            else:
                wanted.append(job)
        figures = measure(wanted, folder, chosen.runs)
        for line in table(figures):
            print(line)
        for line in ratios(figures, chosen.frames, chosen.long):
            print(line)


if __name__ == "__main__":
    main()
