"""Trajectories from captured traffic: the set points of slvMove, one trajectory per slave-mode session."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from bcapscope.analysis.slave import captured_trajectory as seen
from bcapscope.analysis.slave.captured_trajectory import TrajectoryExtractor
from bcapscope.capture.capture_input import CaptureInput
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.player.column_layout import ReadOptions
from bcapscope.player.trajectory import (
    MAX_POINTS,
    MIN_COLUMNS,
    Column,
    Trajectory,
    TrajectoryError,
    TrajectorySource,
)

SOURCE_FORMAT = Message("trajectory.format.capture")


@dataclass(slots=True)
class _SlaveSessionPoints:
    trajectory: seen.CapturedTrajectory
    numbers: array[float] = field(default_factory=lambda: array("d"))
    odd_count: int = 0


def read_capture(source: TrajectorySource, options: ReadOptions) -> tuple[Trajectory, ...]:
    """Read the set points of each slave-mode session in a capture. Raises TrajectoryError if no session has
    set points of the wanted pose type. Raises CaptureError if the capture is damaged before the first set
    point.
    """
    sessions: dict[int, _SlaveSessionPoints] = {}
    problems: list[CaptureError] = []
    capture = CaptureInput([source.path], (), lambda path, error: problems.append(error))
    extractor = TrajectoryExtractor()
    _add_set_points(sessions, capture.read_items(capture.pipeline(extractor), extractor.ready))
    extractor.finish()
    _add_set_points(sessions, extractor.ready)
    if not sessions:
        if problems:
            raise problems[0]
        if extractor.set_points:
            raise TrajectoryError(Message("trajectory.none-playable", count=extractor.set_points))
        raise TrajectoryError(Message("trajectory.no-set-points"))
    notes = [
        Message("trajectory.note.left-out", count=count, reason=reason.message)
        for reason, count in extractor.left_out.items()
    ]
    notes += [Message("trajectory.note.breaks-off", reason=error.message) for error in problems]
    source = replace(source, notes=(*source.notes, *notes))
    made = tuple(
        _make_trajectory(session, source, len(sessions) > 1) for _, session in sorted(sessions.items())
    )
    fitting = tuple(each for each in made if options.kind in (None, each.kind))
    if not fitting:
        kind, wanted = str(made[0].kind), str(options.kind)
        raise TrajectoryError(Message("trajectory.other-kind", kind=kind, wanted=wanted))
    return fitting


def _add_set_points(
    slave_sessions: dict[int, _SlaveSessionPoints], pieces: Iterable[seen.TrajectoryPiece]
) -> None:
    for known, steps in pieces:
        session = slave_sessions.setdefault(known.session_number, _SlaveSessionPoints(known))
        width = len(session.trajectory.axes)
        for step in steps:
            if len(step.commanded) == width:
                session.numbers.extend(step.commanded)
            else:
                session.odd_count += 1
        if len(session.numbers) > MAX_POINTS * width:
            raise TrajectoryError(Message("trajectory.too-long", limit=MAX_POINTS))


def _make_trajectory(
    slave_session: _SlaveSessionPoints, source: TrajectorySource, several: bool
) -> Trajectory:
    known, axes = slave_session.trajectory, slave_session.trajectory.axes
    kind = known.mode.pose_type
    if kind is None or len(axes) < MIN_COLUMNS[kind]:
        raise TrajectoryError(Message("trajectory.unknown-kind", number=known.session_number))
    mode, client = Message("trajectory.mode-not-seen"), str(known.conversation.client)
    if known.mode.value is not None:
        mode = Message("trajectory.mode", mode=f"{known.mode.value:03X}")
    part = Message("trajectory.part.session", number=known.session_number, client=client, mode=mode)
    notes = [*source.notes, Message("trajectory.note.sent-by", client=client, mode=mode)]
    if slave_session.odd_count:
        notes.append(Message("trajectory.note.odd-axes", count=slave_session.odd_count))
    source = replace(
        source,
        file_format=SOURCE_FORMAT,
        part=part if several else None,
        columns=tuple(Column(axis.name, place, "slvMove", axis.unit) for place, axis in enumerate(axes, 1)),
        notes=tuple(notes),
    )
    points = np.frombuffer(slave_session.numbers, dtype=np.float64).reshape(-1, len(axes)).copy()
    return Trajectory(kind, points, source, known.grid_ms / 1000)
