"""Trajectories for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcapscope.messages import Message
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import Column, Trajectory, TrajectorySource
from bcapscope.protocol.slave_mode.modes import PoseType

PERIOD = 0.008
NOWHERE = TrajectorySource("way.csv", Message.from_table("text", "table"))


def way(
    points: Array | Sequence[Sequence[float]],
    kind: PoseType = PoseType.J,
    period: float | None = PERIOD,
    times: Sequence[float] | None = None,
    columns: tuple[Column, ...] = (),
) -> Trajectory:
    """Make a trajectory of rows."""
    rows = np.array(points, dtype=np.float64)
    moments = None if times is None else np.array(times, dtype=np.float64)
    return Trajectory(
        kind,
        rows,
        TrajectorySource("way.csv", Message.from_table("text", "table"), columns=columns),
        period,
        moments,
    )


def swing(seconds: float = 2.0, degrees: float = 30.0, period: float = PERIOD) -> Array:
    """Return six joints that go from 0 to some degrees and back, at rest at both ends."""
    part = np.linspace(0, 1, round(seconds / period) + 1)
    share = (1 - np.cos(2 * np.pi * (part - np.sin(2 * np.pi * part) / (2 * np.pi)))) / 2
    return np.outer(share, np.array([1, -0.5, 0.25, 1, 0.5, -1]) * degrees)


def texts(messages: Sequence[Message]) -> tuple[str, ...]:
    """Return messages in English."""
    return tuple(map(str, messages))
