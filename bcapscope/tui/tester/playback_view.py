"""Show a run of the player: curves of the axes, cycle times, lateness of set points, buffer, and time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container

from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.render.columns import wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.play_text import (
    axis_charts,
    cycle_histogram_lines,
    play_summary_lines,
    progress_bar,
    run_figure_lines,
    trouble_lines,
)
from bcapscope.tui.controller_access.playback import PlaybackRun
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, reader_words
from bcapscope.tui.widgets.text_widgets import InkedText

_MIN_CHART_ROWS = 6


class PlaybackView(Container, can_focus=True):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right", "axes(1)", "tester.axes"),
        Binding("left", "axes(-1)", "", show=False),
    ]

    _playback: PlaybackRun | None = None
    _first_axis = 0

    def compose(self) -> ComposeResult:
        yield InkedText(id="curves")
        yield InkedText(id="figures")

    def show_run(self, run: PlaybackRun) -> None:
        self._playback = run
        self.query_one("#curves", InkedText).show_text("\n".join(self._curve_lines(run)), layout=False)
        self.query_one("#figures", InkedText).show_text("\n".join(self._figure_lines(run)), layout=False)

    def action_axes(self, by: int) -> None:
        if self._playback is not None:
            self._first_axis = (self._first_axis + by) % len(self._axes_by_travel(self._playback))
            self.show_run(self._playback)

    def on_resize(self) -> None:
        if self._playback is not None:
            self.show_run(self._playback)

    def _curve_lines(self, run: PlaybackRun) -> Iterator[str]:
        size = self.query_one("#curves").size
        axes = self._axes_by_travel(run)
        most = max(1, size.height // _MIN_CHART_ROWS)
        shown = sorted((axes[self._first_axis :] + axes[: self._first_axis])[:most])
        return axis_charts(
            run.trajectory.kind,
            tuple(run.samples),
            shown,
            width=size.width - 1,
            height=size.height,
            palette=INK,
            words=reader_words(),
        )

    def _axes_by_travel(self, run: PlaybackRun) -> list[int]:
        """Return the indexes of the moving axes, or of all axes if none moves, largest travel first."""
        points = run.trajectory.points
        ways = [float(points[:, at].max() - points[:, at].min()) for at in range(points.shape[1])]
        names = AXES[run.trajectory.kind]
        axes = sorted(range(min(len(ways), len(names))), key=lambda at: -ways[at])
        return [at for at in axes if ways[at] > 0] or axes

    def _figure_lines(self, run: PlaybackRun) -> Iterator[str]:
        progress = run.progress
        width = self.query_one("#figures").size.width
        if run.ended is not None:
            yield from _wrapped_lines(play_summary_lines(run.ended, reader_words()), INK.name, width)
            yield from _wrapped_lines(
                [label("tester.recorded", path=printable(run.plan.record or ""))], INK.dim, width
            )
        elif progress is not None:
            yield progress_bar(progress, max(1, width - 2), INK)
            yield from run_figure_lines(progress, run.buffer_margin, INK, reader_words())
        for trouble in run.troubles[-3:]:
            yield from _wrapped_lines(trouble_lines(trouble, reader_words()), INK.bad, width)
        if progress is not None and progress.cycle:
            yield ""
            yield from cycle_histogram_lines(progress, INK)
        if run.readiness is not None:
            yield from _wrapped_lines([printable(reader_words().text(run.readiness))], INK.dim, width)


def _wrapped_lines(lines: Iterable[str], ink: str, width: int) -> Iterator[str]:
    for line in lines:
        yield from (f"{ink}{part}{INK.reset}" for part in wrap_text(line.strip(), max(20, width - 2)))
