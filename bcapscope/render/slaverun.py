"""A run in slave mode while it lasts: joints over time, cycle times, lateness, buffer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from bcapscope.analysis.distribution import Bin
from bcapscope.protocol.poses import AXES
from bcapscope.protocol.slavemode import PoseType
from bcapscope.render.braille import Curve, chart
from bcapscope.render.histogram import histogram
from bcapscope.render.palette import PLAIN, Palette

if TYPE_CHECKING:  # what the player's messages are made of reaches sockets
    from bcapscope.player.messages import Progress

_TALLEST = 16
"""Rows of one chart at most: a taller one tells no more."""

Course = Sequence[tuple[float, Sequence[float], Sequence[float]]]
"""Elapsed seconds, what was commanded, what came back."""


def axis_charts(
    kind: PoseType,
    course: Course,
    axes: Sequence[int],
    *,
    width: int,
    height: int,
    palette: Palette = PLAIN,
) -> Iterator[str]:
    """Draw an axis a chart, commanded over actual, each with a title that has both numbers.

    Args:
        kind: of the poses.
        course: readings in the order of their times.
        axes: indexes of those to draw.
        width: columns.
        height: rows of all charts together.
        palette: `number` is for what was commanded, `good` for what came back.
    """
    each = min(_TALLEST, max(4, height // max(1, len(axes))))
    for axis in axes:
        commanded = [(time, point[axis]) for time, point, _ in course if axis < len(point)]
        actual = [(time, pose[axis]) for time, _, pose in course if axis < len(pose)]
        yield _title(kind, axis, commanded, actual, palette)
        curves = [Curve(actual, palette.good), Curve(commanded, palette.number)]
        yield from chart(curves, width, each - 1, palette, AXES[kind][axis].unit.replace("deg", "°"))


def _title(
    kind: PoseType,
    axis: int,
    commanded: Sequence[tuple[float, float]],
    actual: Sequence[tuple[float, float]],
    palette: Palette,
) -> str:
    text = f"{palette.name}{AXES[kind][axis].name}{palette.reset}"
    if commanded:
        text += f"  {palette.number}commanded {commanded[-1][1]:.3f}{palette.reset}"
    if actual:
        text += f"  {palette.good}actual {actual[-1][1]:.3f}{palette.reset}"
    if commanded and actual:
        text += f"  {palette.dim}behind {commanded[-1][1] - actual[-1][1]:.3f}{palette.reset}"
    return text


def cycle_lines(progress: Progress, palette: Palette = PLAIN) -> Iterator[str]:
    """Draw the histogram of the times from one set point to the next, ms, a row for each bin that is told."""
    bins = [Bin(low / 1e6, (high + 1) / 1e6, count) for low, high, count in progress.cycle]
    edges = sorted({edge for each in bins for edge in (each.low, each.high)})
    yield from histogram(bins, edges, palette)


def figure_lines(
    progress: Progress, slack: tuple[int, float, float] | None, palette: Palette = PLAIN
) -> Iterator[str]:
    """Write elapsed and left, lateness, retries and the model of the controller's buffer.

    Args:
        progress: told last.
        slack: slots, ms that a full buffer lasts, ms of that which were left at the longest pause; None
            where it cannot run empty.
        palette: colours.
    """
    number, reset, late, counts = palette.number, palette.reset, progress.lateness, progress.counts
    of = f" of {progress.of}" if progress.of else ""
    left = "" if progress.left is None else f", {number}{progress.left:.1f} s{reset} left"
    yield (
        f"{palette.name}{progress.state}{reset}  set point {number}{progress.index}{of}{reset}, "
        f"{number}{progress.elapsed:.1f} s{reset} elapsed{left}"
    )
    if late.count:
        yield (
            f"late, ms: p50 {number}{late.p50 / 1e6:.3f}{reset} p99 {number}{late.p99 / 1e6:.3f}{reset} "
            f"p99.9 {number}{late.p999 / 1e6:.3f}{reset} most {number}{late.most / 1e6:.3f}{reset}"
        )
    color = palette.problem if counts.unanswered or counts.shifted else number
    yield (
        f"retries {number}{counts.retries}{reset}  late replies {number}{counts.late}{reset}  "
        f"unanswered {color}{counts.unanswered}{reset}  put off {color}{counts.shifted}{reset}"
    )
    if slack is not None:
        slots, whole, rest = slack
        shown = palette.good if rest > whole / 3 else palette.bad
        yield (
            f"buffer (model): {slots} × 8 ms, at the longest pause {shown}{max(0.0, rest):.1f} ms{reset} "
            f"of {whole:.0f} left"
        )


def progress_bar(progress: Progress, width: int, palette: Palette = PLAIN) -> str:
    """Draw how far it is; empty where there is no end."""
    if not progress.of:
        return ""
    done = round(min(1.0, progress.index / progress.of) * width)
    return f"{palette.good}{'━' * done}{palette.dim}{'─' * (width - done)}{palette.reset}"
