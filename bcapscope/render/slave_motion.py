"""Where the set points of a stay lead, for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.slave.motion_model import AxisMotion, MotionFacts, Peak
from bcapscope.analysis.statistics.distribution import DistributionSummary
from bcapscope.protocol.text_format import counted
from bcapscope.render.captioned import captioned_line, continued_line, frames_text, times_text, wrapped_lines
from bcapscope.render.color_palette import Palette
from bcapscope.render.columns import align_columns
from bcapscope.render.tongue import Tongue, english


def motion_lines(motion: MotionFacts, palette: Palette, tongue: Tongue = english) -> Iterator[str]:
    """Write steps, velocities and accelerations by axis, and how far off the returned pose is."""
    guessed = ", their type guessed from the count of numbers" if motion.pose_type_guessed else ""
    yield captioned_line("motion", f"{motion.read} poses read{guessed}", palette, tongue)
    if motion.unread:
        yield continued_line(f"{motion.unread} could not be read, or are of another type", tongue)
    if motion.not_finite:
        frames = frames_text(motion.not_finite_frames, motion.not_finite)
        text = f"{motion.not_finite} hold NaN or infinity; {frames}"
        yield from wrapped_lines(text, palette.problem, palette.reset, tongue)
    yield from _axes([axis for axis in motion.axes if axis.name != "Fig"], palette, tongue)
    yield from _oddities(motion, palette, tongue)


_AXIS_HEADER = (
    ("", "from", "to", "step", "at frame", "velocity", "", "acceleration", "", "off", "", "lag"),
    ("", "", "", "max", "", "p99", "max", "p99", "max", "p99", "max", "cycles"),
)


def _axes(axes: Sequence[AxisMotion], palette: Palette, tongue: Tongue) -> Iterator[str]:
    moving = [axis for axis in axes if axis.least != axis.most]
    if not moving:
        if axes:
            yield continued_line("no axis moves", tongue)
        return
    head = (tuple(map(tongue, row)) for row in _AXIS_HEADER)
    rows = [*head, *map(_axis, moving)]
    first, second, *others = align_columns(rows, "<" + ">" * (len(_AXIS_HEADER[0]) - 1))
    yield f"  {palette.dim}{first}{palette.reset}"
    yield f"  {palette.dim}{second}{palette.reset}"
    yield from (f"  {line}" for line in others)
    still = [axis.name for axis in axes if axis.least == axis.most]
    if still:
        yield continued_line(f"standing still: {' '.join(still)}", tongue)
    text = "units of the axis, a second, a second squared; off: commanded less returned"
    yield from wrapped_lines(text, tongue=tongue)


def _axis(axis: AxisMotion) -> tuple[str, ...]:
    unit = f" {axis.unit}" if axis.unit else ""
    step = axis.largest_step
    return (
        f"{axis.name}{unit}",
        _short_number(axis.least),
        _short_number(axis.most),
        _peak(step),
        "" if step is None else str(step.frame),
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
    """Write a number with four digits, as many as a column of a table can take."""
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _oddities(motion: MotionFacts, palette: Palette, tongue: Tongue) -> Iterator[str]:
    if motion.first_distance:
        yield continued_line(f"first point {_distance(motion)} from where the robot stood,", tongue)
        yield continued_line(f"by {motion.first_distance_known_by}", tongue)
    if motion.repeated:
        points = counted(motion.repeated, "point")
        text = f"{points} equal to the one before"
        if motion.stutters:
            frames = frames_text(motion.stutter_frames, motion.stutters)
            text = f"{text}, {motion.stutters} of them between two that move; {frames}"
        yield from wrapped_lines(text, tongue=tongue)
    if motion.jumps:
        first = motion.jump_list[0]
        steps = counted(motion.jumps, "step")
        text = f"{steps} far larger than those beside or than any axis follows"
        text = f"{text}, the first {first.step:.4g} on {first.axis}"
        frames = frames_text([jump.frame for jump in motion.jump_list], motion.jumps)
        yield from wrapped_lines(f"{text}; {frames}", palette.problem, palette.reset, tongue)
    if motion.figure_changes:
        yield continued_line(f"Fig changes {times_text(motion.figure_changes)}", tongue)


def _distance(motion: MotionFacts) -> str:
    farthest, axis = max(
        zip(motion.first_distance, motion.axes, strict=False),
        key=lambda pair: abs(pair[0]),
        default=(0.0, None),
    )
    return f"{abs(farthest):.4g}" + ("" if axis is None else f" {axis.unit} on {axis.name}")
