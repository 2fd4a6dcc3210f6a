"""The set points of a `ReplayScript`, as trajectories for the player's pre-flight check."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.player.arm_limits import ArmLimits
from bcapscope.player.checks import PreflightProblem, interval_ms, set_point_numbers
from bcapscope.player.preflight import PreflightResult, most_serious_first, run_preflight
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import (
    MIN_COLUMNS,
    Trajectory,
    TrajectorySource,
    find_gaps,
    timing_from_send_times,
)
from bcapscope.protocol.codec.variant import integer_value
from bcapscope.protocol.slave_mode.modes import PoseType, pose_type_of_mode
from bcapscope.protocol.slave_mode.poses import AXES, pose_numbers
from bcapscope.protocol.slave_mode.slvmove_values import parse_set_point
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.replay.replay_script import ReplayScript, ScriptCall

_SHORTEST = 0.001
"""Shortest cycle time in s that the pre-flight check assumes. bcapscope knows no controller with a shorter
cycle time (see `CYCLES` in `player.trajectory`).
"""


class UnreadableSetPointError(BcapError):
    """bcapscope cannot read a set point, and so does not know where the robot would move."""


class SetPointRun(NamedTuple):
    """Successive set points of a `ReplayScript`, between which the client stays in slave mode.

    The trajectory also contains refused set points, because a replay sends these, too. `sent_at` is in
    seconds.
    """

    first_call: int
    trajectory: Trajectory
    sent_at: tuple[float, ...]


def mode_entered(call: ScriptCall) -> int | None:
    """Return the number of the slave mode that a call enters, if any."""
    parameter = command_parameter(call.arguments)
    if parameter is None or call.kind.folded_command != "slvchangemode":
        return None
    return integer_value(parameter) or None


def set_point_runs(script: ReplayScript) -> Iterator[SetPointRun]:
    """Yield each series of set points. Until a call shows the slave mode, assume joint positions.

    Raises UnreadableSetPointError if a set point is not a pose, or the number of axes changes in a series.
    """
    kind, points = PoseType.J, list[ScriptCall]()
    for line in script.calls:
        command = line.kind.folded_command
        if command == "slvmove":
            points.append(line)
        elif command == "slvchangemode":
            if points:
                yield _run_of(kind, points)
            points = []
            kind = pose_type_of_mode(mode_entered(line) or 0) or kind
    if points:
        yield _run_of(kind, points)


def preflight_run(run: SetPointRun, limits: ArmLimits) -> PreflightResult:
    """Run the pre-flight check for set points at their recorded times, including pauses."""
    trajectory = run.trajectory
    found = run_preflight(trajectory, trajectory.period or _SHORTEST, limits)
    pauses = _pause_problems(np.asarray(run.sent_at))
    return replace(found, problems=most_serious_first((*found.problems, *pauses)))


def _run_of(kind: PoseType, calls: list[ScriptCall]) -> SetPointRun:
    rows = [_pose_numbers(line, kind) for line in calls]
    odd = next((line for line, row in zip(calls, rows, strict=True) if len(row) != len(rows[0])), None)
    if odd is not None:
        raise UnreadableSetPointError(Message("replay.axes-differ", call=odd.number))
    sent = np.asarray([line.offset for line in calls]) / 1e9
    timing = timing_from_send_times(sent)
    usual = float(np.median(np.diff(sent))) if len(sent) > 1 else _SHORTEST
    return SetPointRun(
        calls[0].number,
        Trajectory(
            kind,
            np.asarray(rows, dtype=np.float64),
            TrajectorySource("", Message("replay.run", call=calls[0].number)),
            period=timing.period or max(usual, _SHORTEST),
        ),
        tuple((sent - sent[0]).tolist()),
    )


def _pose_numbers(call: ScriptCall, kind: PoseType) -> tuple[float, ...]:
    parameter = command_parameter(call.arguments)
    row = None if parameter is None else pose_numbers(parameter)
    if row is None and parameter is not None:
        pose = parse_set_point(parameter, kind).pose
        row = None if pose is None else pose.values
    if row is None or len(row) < MIN_COLUMNS[kind]:
        raise UnreadableSetPointError(Message("replay.no-pose", call=call.number, kind=str(kind)))
    return tuple(row[: len(AXES[kind])])


def _pause_problems(sent_at: Array) -> Iterator[PreflightProblem]:
    if len(sent_at) < 2:
        return
    points, count = set_point_numbers(find_gaps(sent_at), 2)
    if count:
        steps = np.diff(sent_at)
        fact = Message(
            "preflight.pause",
            pauses=Count(count, "pause"),
            longest=interval_ms(float(steps.max())),
            usual=interval_ms(float(np.median(steps))),
        )
        advice = Message("preflight.advice.pause")
        yield PreflightProblem("gap", Severity.WARNING, fact, advice, points, count)
