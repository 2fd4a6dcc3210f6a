"""Files to be played: what must hold for any bytes at all."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from bcapscope.player.arm_limits import SIMULATED_ARM
from bcapscope.player.preflight import run_preflight
from bcapscope.player.resampling import resample, stop_after
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.render.preflight_text import PreflightRenderer, preflight_record, source_lines

NAMES = ("way.csv", "way.json", "way.yaml")
PERIOD = 0.008

_LONGEST = 100.0


def trajectory(data: bytes) -> None:
    """Read `data`, a file behind one byte that tells its name; check, resample and stop what it gives."""
    if not data:
        return
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        path = Path(folder, NAMES[data[0] % len(NAMES)])
        path.write_bytes(data[1:])
        told = ""
        found: tuple[Trajectory, ...] = ()
        try:
            found = read_trajectories(path)
        except TrajectoryError as error:
            told = str(error)
    assert bool(told) is not bool(found)
    assert "\n" not in told
    for each in found:
        play(each)


def play(each: Trajectory) -> None:
    """Do with a trajectory all that is done before and while it is played, but for sending."""
    limits = SIMULATED_ARM
    before = run_preflight(each, PERIOD, limits)
    shown = [*source_lines(each), *PreflightRenderer().lines(before), preflight_record(before).decode()]
    assert all(char.isprintable() or char == "\u3000" for line in shown for char in line)
    if not before.seconds < _LONGEST or any(finding.check == "not-finite" for finding in before.problems):
        return
    try:
        again = resample(each, PERIOD)
    except TrajectoryError:
        return
    assert np.array_equal(again.points[[0, -1]], each.points[[0, -1]])
    after = run_preflight(again, PERIOD, limits)
    assert not {"not-finite", "interval", "gap"} & {finding.check for finding in after.problems}
    middle = len(again) // 2
    assert np.isfinite(stop_after(again, middle, PERIOD, limits)).all()
