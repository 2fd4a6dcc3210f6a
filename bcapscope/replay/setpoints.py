"""The set points of a script, as the player's pre-flight looks at trajectories."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.errors import BcapError
from bcapscope.player.curve import Array
from bcapscope.player.finding import Finding, numbered, span_text
from bcapscope.player.limits import Limits
from bcapscope.player.preflight import Preflight, check
from bcapscope.player.timing import gaps, of_sending
from bcapscope.player.trajectory import FEWEST, Source, Trajectory
from bcapscope.protocol.poses import AXES, numbers
from bcapscope.protocol.setpoints import split_set_point
from bcapscope.protocol.slavemode import PoseType, mode_pose_type, mode_value
from bcapscope.protocol.wording import counted
from bcapscope.replay.script import Line, Script

_SHORTEST = 0.001
"""Seconds that set points count as apart at least; no controller takes them faster."""


class UnreadableError(BcapError):
    """A set point cannot be read, so that nobody knows where it would send the robot."""


class Stretch(NamedTuple):
    """Set points that are sent without leaving slave mode in between.

    Attributes:
        first: number of the call of the first of them.
        trajectory: where they go, whatever the recorded controller answered: all of them are sent again.
        sent: seconds at which they were sent, from the first.
    """

    first: int
    trajectory: Trajectory
    sent: tuple[float, ...]


def command_of(line: Line) -> str | None:
    """Return the command of a line, in lower case."""
    return line.question.command.casefold() if line.question.command is not None else None


def mode_entered(line: Line) -> int | None:
    """Return the slave mode that a line enters; None if it enters none."""
    if command_of(line) != "slvchangemode" or len(line.arguments) < 3:
        return None
    return mode_value(line.arguments[2]) or None


def stretches(script: Script) -> Iterator[Stretch]:
    """Yield the set points of a script.

    Where slave mode was not entered, they count as joints.

    Raises:
        UnreadableError: one of them is no pose, or has another number of axes than the one before.
    """
    kind, points = PoseType.J, list[Line]()
    for line in script.lines:
        command = command_of(line)
        if command == "slvmove":
            points.append(line)
        elif command == "slvchangemode":
            if points:
                yield _stretch(kind, points)
            points = []
            kind = mode_pose_type(mode_entered(line) or 0) or kind
    if points:
        yield _stretch(kind, points)


def preflight(stretch: Stretch, limits: Limits) -> Preflight:
    """Look at a stretch as the player does at a trajectory, at the pace at which it was sent."""
    trajectory = stretch.trajectory
    found = check(trajectory, trajectory.period or _SHORTEST, limits)
    more = tuple(_gaps(np.asarray(stretch.sent)))
    rank = list(Severity)
    every = sorted((*found.findings, *more), key=lambda finding: rank.index(finding.severity))
    return replace(found, findings=tuple(every))


def _stretch(kind: PoseType, lines: list[Line]) -> Stretch:
    rows = [_row(line, kind) for line in lines]
    odd = next((line for line, row in zip(lines, rows, strict=True) if len(row) != len(rows[0])), None)
    if odd is not None:
        raise UnreadableError(f"call {odd.call}, a set point, has another number of axes than the first")
    sent = np.asarray([line.at for line in lines]) / 1e9
    timing = of_sending(sent)
    usual = float(np.median(np.diff(sent))) if len(sent) > 1 else _SHORTEST
    return Stretch(
        lines[0].call,
        Trajectory(
            kind,
            np.asarray(rows, dtype=np.float64),
            Source("", f"set points from call {lines[0].call} on"),
            period=timing.period or max(usual, _SHORTEST),
        ),
        tuple((sent - sent[0]).tolist()),
    )


def _row(line: Line, kind: PoseType) -> tuple[float, ...]:
    parameter = line.arguments[2] if len(line.arguments) > 2 else None
    row = None if parameter is None else numbers(parameter)
    if row is None and parameter is not None:
        pose = split_set_point(parameter, kind).pose
        row = None if pose is None else pose.values
    if row is None or len(row) < FEWEST[kind]:
        raise UnreadableError(f"call {line.call}, a set point, is no pose of type {kind}")
    return tuple(row[: len(AXES[kind])])


def _gaps(sent: Array) -> Iterator[Finding]:
    if len(sent) < 2:
        return
    points, count = numbered(gaps(sent), 2)
    if count:
        steps = np.diff(sent)
        sentence = (
            f"{counted(count, 'pause')} between set points, the longest of {span_text(float(steps.max()))} "
            f"where {span_text(float(np.median(steps)))} are usual"
        )
        yield Finding("gap", Severity.WARNING, sentence, "slave mode may end there", points, count)
