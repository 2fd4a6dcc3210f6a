"""Trajectories from captured traffic: the set points of slvMove, one trajectory per slave-mode session."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from bcapscope.analysis.slave import captured_trajectory as seen
from bcapscope.analysis.slave.captured_trajectory import TrajectoryExtractor
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.capture.role_detection import BCAP_PORTS
from bcapscope.errors import CaptureError
from bcapscope.player.column_layout import ReadOptions
from bcapscope.player.trajectory import (
    MAX_POINTS,
    MIN_COLUMNS,
    Column,
    Trajectory,
    TrajectoryError,
    TrajectorySource,
)
from bcapscope.traffic.pipeline import Pipeline

SOURCE_FORMAT = "set points in a capture"


@dataclass(slots=True)
class _SlaveSessionPoints:
    """Set points of one slave-mode session, collected as they are found."""

    trajectory: seen.CapturedTrajectory
    numbers: array[float] = field(default_factory=lambda: array("d"))
    odd_count: int = 0


def read_capture(
    packets: Iterable[Packet],
    source: TrajectorySource,
    options: ReadOptions,
    ports: Collection[int] = BCAP_PORTS,
) -> tuple[Trajectory, ...]:
    """Read the set points of each slave-mode session.

    Args:
        packets: Packets of the capture.
        source: Where the packets come from.
        options: What the user says about the file.
        ports: Ports of controllers.

    Raises:
        TrajectoryError: There are no set points, or none of the wanted type.
        CaptureError: The capture cannot be read, and nothing was found before the fault.
    """
    sessions: dict[int, _SlaveSessionPoints] = {}
    extractor = TrajectoryExtractor()
    pipeline = Pipeline(extractor)
    broken: CaptureError | None = None
    try:
        for observation in PacketDecoder(ports).decode(packets):
            pipeline.add(observation)
            if extractor.ready:
                _add_set_points(sessions, extractor.ready)
                extractor.ready.clear()
    except CaptureError as error:
        broken = error
    pipeline.finish()
    extractor.finish()
    _add_set_points(sessions, extractor.ready)
    if not sessions:
        if broken is not None:
            raise broken
        if extractor.set_points:
            raise TrajectoryError(f"{extractor.set_points} set points, none of which can be played")
        raise TrajectoryError("there are no set points (slvMove) in this capture")
    notes = [f"left out: {count} {reason.message}" for reason, count in extractor.left_out.items()]
    if broken is not None:
        notes.append(f"the capture breaks off: {broken}")
    source = replace(source, notes=(*source.notes, *notes))
    made = tuple(
        _make_trajectory(session, source, len(sessions) > 1) for _, session in sorted(sessions.items())
    )
    fitting = tuple(each for each in made if options.kind in (None, each.kind))
    if not fitting:
        raise TrajectoryError(f"the set points are of type {made[0].kind}, not {options.kind}")
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
            raise TrajectoryError(f"more than {MAX_POINTS} set points")


def _make_trajectory(
    slave_session: _SlaveSessionPoints, source: TrajectorySource, several: bool
) -> Trajectory:
    known, axes = slave_session.trajectory, slave_session.trajectory.axes
    kind = known.mode.pose_type
    if kind is None or len(axes) < MIN_COLUMNS[kind]:
        raise TrajectoryError(f"the set points of stay {known.session_number} are of no known type")
    value = "mode not seen" if known.mode.value is None else f"mode 0x{known.mode.value:03X}"
    part = f"stay {known.session_number}, {known.conversation.client}, {value}"
    told = f"sent by {known.conversation.client}, {value}; each counts as one cycle, whenever it was sent"
    notes = [*source.notes, told]
    if slave_session.odd_count:
        notes.append(f"{slave_session.odd_count} with another number of axes left out")
    return Trajectory(
        kind=kind,
        points=np.frombuffer(slave_session.numbers, dtype=np.float64).reshape(-1, len(axes)).copy(),
        source=replace(
            source,
            file_format=SOURCE_FORMAT,
            part=part if several else "",
            columns=tuple(
                Column(axis.name, place, "slvMove", axis.unit) for place, axis in enumerate(axes, 1)
            ),
            notes=tuple(notes),
        ),
        period=known.grid_ms / 1000,
    )
