"""A run in slave mode while it lasts: curves of the axes, cycle times, lateness, buffer, elapsed and left."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container

from bcapscope.protocol.poses import AXES
from bcapscope.render.columns import wrapped
from bcapscope.render.escape import printable
from bcapscope.render.playing import ended_lines, trouble_lines
from bcapscope.render.slaverun import axis_charts, cycle_lines, figure_lines, progress_bar
from bcapscope.tui.desk.slaverun import SlaveRun
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.inked import InkedText
from bcapscope.tui.words import say, told

_ROWS = 6
"""Rows that one chart has at least."""


class SlaveLive(Container, can_focus=True):
    """Watches one run."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right", "axes(1)", "tester.axes", id="slave.axes", tooltip="tester.axes.tip"),
        Binding("left", "axes(-1)", "", show=False),
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._run: SlaveRun | None = None
        self._first = 0

    def compose(self) -> ComposeResult:
        """Put the curves beside the figures, or above them where there is no room."""
        yield InkedText(id="curves")
        yield InkedText(id="figures")

    def show(self, run: SlaveRun) -> None:
        """Show what is known of a run by now."""
        self._run = run
        self.query_one("#curves", InkedText).write("\n".join(self._curves(run)), layout=False)
        self.query_one("#figures", InkedText).write("\n".join(self._figures(run)), layout=False)

    def action_axes(self, by: int) -> None:
        """Show the curves of other axes."""
        if self._run is not None:
            self._first = (self._first + by) % len(self._moving(self._run))
            self.show(self._run)

    def on_resize(self) -> None:
        """Draw for the new size."""
        if self._run is not None:
            self.show(self._run)

    def _curves(self, run: SlaveRun) -> Iterator[str]:
        size = self.query_one("#curves").size
        axes = self._moving(run)
        most = max(1, size.height // _ROWS)
        shown = sorted((axes[self._first :] + axes[: self._first])[:most])
        return axis_charts(
            run.trajectory.kind,
            tuple(run.course),
            shown,
            width=size.width - 1,
            height=size.height,
            palette=INK,
            tongue=told,
        )

    def _moving(self, run: SlaveRun) -> list[int]:
        """List the axes, those that move most first."""
        points = run.trajectory.points
        ways = [float(points[:, at].max() - points[:, at].min()) for at in range(points.shape[1])]
        names = AXES[run.trajectory.kind]
        axes = sorted(range(min(len(ways), len(names))), key=lambda at: -ways[at])
        return [at for at in axes if ways[at] > 0] or axes

    def _figures(self, run: SlaveRun) -> Iterator[str]:
        progress = run.progress
        width = self.query_one("#figures").size.width
        if run.ended is not None:
            yield from _folded(ended_lines(run.ended), INK.name, width)
            yield from _folded(
                [say("tester.recorded", path=printable(run.plan.record or ""))], INK.dim, width
            )
        elif progress is not None:
            yield progress_bar(progress, max(1, width - 2), INK)
            yield from figure_lines(progress, run.slack, INK, told)
        for trouble in run.troubles[-3:]:
            yield from _folded(trouble_lines(trouble), INK.bad, width)
        if progress is not None and progress.cycle:
            yield ""
            yield from cycle_lines(progress, INK)
        if run.readiness:
            yield from _folded([run.readiness], INK.dim, width)


def _folded(lines: Iterable[str], ink: str, width: int) -> Iterator[str]:
    """Put lines into the language of the labels; break those that are longer than there is room."""
    for line in lines:
        yield from (f"{ink}{part}{INK.reset}" for part in wrapped(told(line.strip()), max(20, width - 2)))
