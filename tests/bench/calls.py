"""What pairs frames to calls beside tshark, all in one run: seconds, processor seconds, peak memory, ratios.

tshark reads the same capture without any b-CAP, a line a packet: it does less.
Run from the project's root as ``python -m tests.bench.calls``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.bench.jobs import CHECK_FRAMES, Figures, Job, main, memory, python, ratios, tshark
from tests.bench.traffic import Truth, write

ALONE = "tshark, no b-CAP"
CALLS, STATS = "bcapscope calls --json", "bcapscope stats --json"
SLAVE, DIAGNOSE = "bcapscope slave --json", "bcapscope diagnose --json"
OURS = (CALLS, STATS, SLAVE, DIAGNOSE)
OPENING_CALLS = 5


def truth() -> Truth:
    """Say what is in the small capture."""
    with tempfile.TemporaryDirectory(prefix="bcap-bench-") as folder:
        return write(Path(folder) / "small.pcap", CHECK_FRAMES)


def jobs(frames: int, long_frames: int) -> list[Job]:
    """List what to run: all on `frames`, ours on `long_frames` too."""
    calls = truth().calls
    points = calls - OPENING_CALLS
    marks = {
        CALLS: (b'{"call":', calls),
        STATS: (b'"total":{"calls":%d,' % calls, 1),
        SLAVE: (b'"set_points":{"sent":%d,' % points, 1),
        DIAGNOSE: (b'{"finding":', 3),  # sent again, replied to late, type not checked
    }
    ours = [Job(name, 0, python(*name.split(), "{}"), *mark) for name, mark in marks.items()]
    return [
        Job(ALONE, frames, tshark(), b"\n"),
        *(job._replace(frames=frames) for job in ours),
        *(job._replace(frames=long_frames) for job in ours),
    ]


def told(figures: Figures, frames: int, long_frames: int) -> Iterator[str]:
    """Yield how often tshark's time is ours, and what memory does when the capture grows."""
    yield from ratios(figures, [(ALONE, name, frames) for name in OURS])
    for name in OURS:
        yield from memory(figures, name, frames, long_frames)


if __name__ == "__main__":
    main(__doc__, jobs, told)
