"""The commanded motion of a slave-mode session as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.slave.motion_model import AxisMotion, MotionFacts, Peak
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, Quantity, Times, frames_text
from bcapscope.render.captioned import CaptionWriter, frames_message


def motion_lines(motion: MotionFacts, writer: CaptionWriter) -> Iterator[str]:
    """Yield lines with steps, velocities and accelerations of each axis, and the deviation of the returned
    pose.
    """
    case = ".guessed" if motion.pose_type_guessed else ""
    yield writer.captioned("motion", Message(f"slave.motion{case}", poses=Count(motion.read, "pose")))
    if motion.unread:
        yield writer.continued(Message("slave.motion.unread", n=motion.unread))
    if motion.not_finite:
        frames = frames_message(motion.not_finite_frames, motion.not_finite)
        text = Message("slave.motion.not-finite", n=motion.not_finite, frames=frames)
        yield from writer.wrapped(text, writer.palette.problem)
    yield from _axes([axis for axis in motion.axes if axis.name != "Fig"], writer)
    yield from _oddities(motion, writer)


_AXIS_HEADER = (
    ("", "least", "most", "step", "at-frame", "velocity", "", "acceleration", "", "off", "", "lag"),
    ("", "", "", "max", "", "p99", "max", "p99", "max", "p99", "max", "cycles"),
)
"""Ids of the column headings, in two rows."""


def _axes(axes: Sequence[AxisMotion], writer: CaptionWriter) -> Iterator[str]:
    moving = [axis for axis in axes if axis.least != axis.most]
    if not moving:
        if axes:
            yield writer.continued(Message("slave.motion.none"))
        return
    head = [
        tuple(writer.label(f"slave.column.{name}") if name else "" for name in row) for row in _AXIS_HEADER
    ]
    yield from writer.table(
        [*head, *(_axis(each, writer.words) for each in moving)], "<" + ">" * (len(head[0]) - 1), len(head)
    )
    still = [axis.name for axis in axes if axis.least == axis.most]
    if still:
        yield writer.continued(Message("slave.motion.still", axes=" ".join(still)))
    yield from writer.wrapped(Message("slave.motion.units"))


def _axis(axis: AxisMotion, words: MessageFormatter) -> tuple[str, ...]:
    unit = f" {axis.unit}" if axis.unit else ""
    step = axis.largest_step
    return (
        f"{axis.name}{unit}",
        _short_number(axis.least),
        _short_number(axis.most),
        _peak(step),
        "" if step is None else frames_text((step.frame,), words),
        *_p99_and_max(axis.velocity),
        *_p99_and_max(axis.acceleration),
        *_p99_and_max(axis.difference),
        "" if axis.lag_cycles is None else f"{axis.lag_cycles:.1f}",
    )


def _peak(peak: Peak | None) -> str:
    return "" if peak is None else _short_number(peak.value)


def _p99_and_max(found: DistributionSummary | None) -> tuple[str, str]:
    return ("", "") if found is None else (_short_number(found.p99), _short_number(found.most))


def _short_number(value: float) -> str:
    """Return a number with about four digits, to keep the table column narrow."""
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _oddities(motion: MotionFacts, writer: CaptionWriter) -> Iterator[str]:
    if motion.first_distance and motion.first_distance_known_by is not None:
        yield from writer.wrapped(_first_point_message(motion, motion.first_distance_known_by))
    if motion.repeated:
        points: dict[str, PlaceValue] = {"points": Count(motion.repeated, "set-point")}
        text = Message("slave.motion.repeated", **points)
        if motion.stutters:
            frames = frames_message(motion.stutter_frames, motion.stutters)
            text = Message(
                "slave.motion.repeated.stutters", **points, stutters=motion.stutters, frames=frames
            )
        yield from writer.wrapped(text)
    if motion.jumps:
        first = motion.jump_list[0]
        text = Message(
            "slave.motion.jumps",
            steps=Count(motion.jumps, "step"),
            step=Quantity(first.step),
            axis=first.axis,
            frames=frames_message([jump.frame for jump in motion.jump_list], motion.jumps),
        )
        yield from writer.wrapped(text, writer.palette.problem)
    if motion.figure_changes:
        yield writer.continued(Message("slave.motion.figure", times=Times(motion.figure_changes)))


def _first_point_message(motion: MotionFacts, known_by: Message) -> Message:
    farthest, axis = max(
        zip(motion.first_distance, motion.axes, strict=False),
        key=lambda pair: abs(pair[0]),
        default=(0.0, None),
    )
    if axis is None:
        return Message("slave.motion.first", distance=Quantity(abs(farthest)), known_by=known_by)
    distance = Quantity(abs(farthest), axis.unit)
    return Message("slave.motion.first.axis", distance=distance, axis=axis.name, known_by=known_by)
