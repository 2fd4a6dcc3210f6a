"""Trajectories out of captured traffic: the set points of slvMove, stay by stay."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from bcapscope.analysis import trajectory as seen
from bcapscope.analysis.trajectory import Trajectories
from bcapscope.capture.observer import Observer
from bcapscope.capture.packet import Packet
from bcapscope.capture.sides import PORTS
from bcapscope.errors import CaptureError
from bcapscope.player.layout import Wishes
from bcapscope.player.trajectory import FEWEST, MOST_POINTS, Column, Source, Trajectory, TrajectoryError
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.tracker import Tracker

FORM = "set points in a capture"


@dataclass(slots=True)
class _Stay:
    """Set points of one stay in slave mode, as they are found."""

    known: seen.Trajectory
    numbers: array[float] = field(default_factory=lambda: array("d"))
    odd: int = 0


def read_capture(
    packets: Iterable[Packet], source: Source, wishes: Wishes, ports: Collection[int] = PORTS
) -> tuple[Trajectory, ...]:
    """Read the set points of each stay in slave mode.

    Args:
        packets: of the capture.
        source: where they are from.
        wishes: what the user says.
        ports: where controllers listen.

    Raises:
        TrajectoryError: there are no set points, or none of the kind that is wished for.
        CaptureError: the capture cannot be read and nothing was found before that.
    """
    stays: dict[int, _Stay] = {}
    follower, tracker = Trajectories(), Tracker()
    broken: CaptureError | None = None
    try:
        for observation in Observer(ports).observe(packets):
            for item in tracker.observe(observation):
                if isinstance(item, Exchange):
                    _add(stays, follower.take(item))
    except CaptureError as error:
        broken = error
    for item in tracker.close():
        if isinstance(item, Exchange):
            _add(stays, follower.take(item))
    _add(stays, follower.finish())
    if not stays:
        if broken is not None:
            raise broken
        told = f"{follower.set_points} set points, none of which can be played" if follower.set_points else ""
        raise TrajectoryError(told or "there are no set points (slvMove) in this capture")
    notes = [f"left out: {count} {reason}" for reason, count in follower.left_out.items()]
    if broken is not None:
        notes.append(f"the capture breaks off: {broken}")
    source = replace(source, notes=(*source.notes, *notes))
    made = tuple(_trajectory(stay, source, len(stays) > 1) for _, stay in sorted(stays.items()))
    fitting = tuple(each for each in made if wishes.kind in (None, each.kind))
    if not fitting:
        raise TrajectoryError(f"the set points are of type {made[0].kind}, not {wishes.kind}")
    return fitting


def _add(stays: dict[int, _Stay], pieces: Iterable[seen.Piece]) -> None:
    for known, steps in pieces:
        stay = stays.setdefault(known.stay, _Stay(known))
        width = len(stay.known.axes)
        for step in steps:
            if len(step.commanded) == width:
                stay.numbers.extend(step.commanded)
            else:
                stay.odd += 1
        if len(stay.numbers) > MOST_POINTS * width:
            raise TrajectoryError(f"more than {MOST_POINTS} set points")


def _trajectory(stay: _Stay, source: Source, several: bool) -> Trajectory:
    known, axes = stay.known, stay.known.axes
    kind = known.mode.pose_type
    if kind is None or len(axes) < FEWEST[kind]:
        raise TrajectoryError(f"the set points of stay {known.stay} are of no known type")
    value = "mode not seen" if known.mode.value is None else f"mode 0x{known.mode.value:03X}"
    part = f"stay {known.stay}, {known.conversation.client}, {value}"
    told = f"sent by {known.conversation.client}, {value}; each counts as one cycle, whenever it was sent"
    notes = [*source.notes, told]
    if stay.odd:
        notes.append(f"{stay.odd} with another number of axes left out")
    return Trajectory(
        kind=kind,
        points=np.frombuffer(stay.numbers, dtype=np.float64).reshape(-1, len(axes)).copy(),
        source=replace(
            source,
            form=FORM,
            part=part if several else "",
            columns=tuple(
                Column(axis.name, place, "slvMove", axis.unit) for place, axis in enumerate(axes, 1)
            ),
            notes=tuple(notes),
        ),
        period=known.grid_ms / 1000,
    )
