"""A run in slave mode while it lasts: joints over time, cycle times, lateness, buffer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from bcapscope.analysis.statistics.distribution import Bin
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.render.braille_chart import ChartCurve, braille_chart
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.histogram import histogram
from bcapscope.render.tongue import Tongue, english

if TYPE_CHECKING:  # what the player's messages are made of reaches sockets
    from bcapscope.player.player_messages import PlayProgress

_MAX_CHART_ROWS = 16
"""Rows of one chart at most: a taller one tells no more."""

_LARGEST_POSITION = 1e9

PoseHistory = Sequence[tuple[float, Sequence[float], Sequence[float]]]
"""Elapsed seconds, what was commanded, what came back."""


def axis_charts(
    kind: PoseType,
    history: PoseHistory,
    axes: Sequence[int],
    *,
    width: int,
    height: int,
    palette: Palette = PLAIN,
    tongue: Tongue = english,
) -> Iterator[str]:
    """Draw an axis a chart, commanded over actual, each with a title that has both numbers.

    Args:
        kind: of the poses.
        history: readings in the order of their times.
        axes: indexes of those to draw.
        width: columns.
        height: rows of all charts together.
        palette: `number` is for what was commanded, `good` for what came back.
        tongue: of the titles.
    """
    each = min(_MAX_CHART_ROWS, max(4, height // max(1, len(axes))))
    for axis in axes:
        commanded = [(time, point[axis]) for time, point, _ in history if axis < len(point)]
        actual = [(time, pose[axis]) for time, _, pose in history if axis < len(pose)]
        yield _title(AXES[kind][axis].name, commanded, actual, palette, tongue)
        curves = [ChartCurve(actual, palette.good), ChartCurve(commanded, palette.number)]
        yield from braille_chart(curves, width, each - 1, palette, AXES[kind][axis].unit.replace("deg", "°"))


def _title(
    name: str,
    commanded: Sequence[tuple[float, float]],
    actual: Sequence[tuple[float, float]],
    palette: Palette,
    tongue: Tongue,
) -> str:
    text = f"{palette.name}{name}{palette.reset}"
    if commanded:
        text += f"  {palette.number}{tongue('commanded')} {_position_text(commanded[-1][1])}{palette.reset}"
    if actual:
        text += f"  {palette.good}{tongue('actual')} {_position_text(actual[-1][1])}{palette.reset}"
    if commanded and actual:
        behind = commanded[-1][1] - actual[-1][1]
        text += f"  {palette.dim}{tongue('behind')} {_position_text(behind)}{palette.reset}"
    return text


def _position_text(value: float) -> str:
    """Write a position; what no axis has, in no more columns."""
    return f"{value:.3f}" if abs(value) < _LARGEST_POSITION else f"{value:.3g}"


def cycle_histogram_lines(progress: PlayProgress, palette: Palette = PLAIN) -> Iterator[str]:
    """Draw the histogram of the times from one set point to the next, ms, a row for each bin that is told."""
    bins = [Bin(low / 1e6, (high + 1) / 1e6, count) for low, high, count in progress.cycle]
    edges = sorted({edge for each in bins for edge in (each.low, each.high)})
    yield from histogram(bins, edges, palette)


def run_figure_lines(
    progress: PlayProgress,
    slack: tuple[int, float, float] | None,
    palette: Palette = PLAIN,
    tongue: Tongue = english,
) -> Iterator[str]:
    """Write elapsed and left, lateness, retries and the model of the controller's buffer.

    Args:
        progress: told last.
        slack: slots, ms that a full buffer lasts, ms of that which were left at the longest pause; None
            where it cannot run empty.
        palette: colours.
        tongue: of the words.
    """
    number, reset, late, counts = palette.number, palette.reset, progress.lateness, progress.counts
    place = tongue(f"{progress.index} of {progress.of}") if progress.of else f"{progress.index}"
    yield (
        f"{palette.name}{tongue(progress.state)}{reset}  {tongue('set point')} {number}{place}{reset}, "
        f"{tongue('elapsed')} {number}{progress.elapsed:.1f} s{reset}"
        + ("" if progress.left is None else f", {tongue('left')} {number}{progress.left:.1f} s{reset}")
    )
    if late.count:
        yield (
            f"{tongue('late, ms:')} p50 {number}{late.p50 / 1e6:.3f}{reset} "
            f"p99 {number}{late.p99 / 1e6:.3f}{reset} p99.9 {number}{late.p999 / 1e6:.3f}{reset} "
            f"{tongue('most')} {number}{late.most / 1e6:.3f}{reset}"
        )
    color = palette.problem if counts.unanswered or counts.shifted else number
    yield (
        f"{tongue('retries')} {number}{counts.retries}{reset}  "
        f"{tongue('late replies')} {number}{counts.late}{reset}  "
        f"{tongue('unanswered')} {color}{counts.unanswered}{reset}  "
        f"{tongue('put off')} {color}{counts.shifted}{reset}"
    )
    if slack is not None:
        slots, whole, rest = slack
        shown = palette.good if rest > whole / 3 else palette.bad
        words = tongue(f"buffer (model): {slots} × 8 ms, left at the longest pause")
        yield f"{words} {shown}{max(0.0, rest):.1f}{reset} / {whole:.0f} ms"


def progress_bar(progress: PlayProgress, width: int, palette: Palette = PLAIN) -> str:
    """Draw how far it is; empty where there is no end."""
    if not progress.of:
        return ""
    done = round(min(1.0, progress.index / progress.of) * width)
    return f"{palette.good}{'━' * done}{palette.dim}{'─' * (width - done)}{palette.reset}"
