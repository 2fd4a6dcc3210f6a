"""Findings, each consequence under its cause; choosing one leads to its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.events import Resize

from bcapscope.analysis.finding import Severity
from bcapscope.render.columns import wrapped
from bcapscope.tui.ink import INK
from bcapscope.tui.traffic.report import Cause
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say

_STEP, _DEEPEST = 3, 4
_WIDEST, _NARROWEST = 120, 30
_MOST_FRAMES = 12


class FindingPage(Lines):
    """Shows findings as paragraphs; up and down go from line to line, enter chooses the finding."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "choose", "findings.choose", id="findings.choose", tooltip="findings.choose.tip"),
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._causes: tuple[Cause, ...] = ()
        self._sum = ""
        self._lines: list[tuple[str, int]] = []

    def show(self, causes: Sequence[Cause], total: str) -> None:
        """Show findings and the line that sums them up."""
        if tuple(causes) != self._causes or total != self._sum:
            self._causes, self._sum = tuple(causes), total
            self._write()

    def finding(self) -> int | None:
        """Tell on which finding the cursor is, from 1."""
        number = self._lines[self.cursor][1] if self._lines else 0
        return number or None

    def go_to(self, number: int) -> None:
        """Go to a finding by its number from 1."""
        for index, (_, each) in enumerate(self._lines):
            if each == number:
                self.go(index)
                return

    @property
    def count(self) -> int:
        """How many lines there are."""
        return len(self._lines)

    def line(self, index: int) -> str:
        """Return a line."""
        return self._lines[index][0]

    def on_resize(self, event: Resize) -> None:
        """Wrap to the new width."""
        self._write()

    def _write(self) -> None:
        here = self.finding()
        self._lines = [(f" {self._sum}", 0), ("", 0)] if self._sum else []
        depths: list[int] = []
        for number, cause in enumerate(self._causes, 1):
            depths.append(depths[cause.consequence_of - 1] + 1 if cause.consequence_of else 0)
            indent = " " * _STEP * min(depths[-1], _DEEPEST)
            self._lines += [
                (f" {indent}{line}", number) for line in self._finding(number, cause, len(indent))
            ]
            self._lines.append(("", number))
        if not self._lines:
            self._lines = [(f" {say('traffic.empty.findings')}", 0)]
        self.changed(min(self.cursor, len(self._lines) - 1))
        if here is not None and here != self.finding():
            self.go_to(here)

    def _finding(self, number: int, cause: Cause, indent: int) -> Iterator[str]:
        width = max(_NARROWEST, min(self.size.width - indent - 4, _WIDEST))
        shade = INK.bad if cause.severity == Severity.ERROR else INK.name
        follows = (
            f", {say('traffic.finding.follows', number=cause.consequence_of)}" if cause.consequence_of else ""
        )
        yield f"{INK.number}{number}{INK.reset} {shade}{cause.severity}{INK.reset} {cause.rule}{follows}"
        frames = ", ".join(map(str, cause.frames[:_MOST_FRAMES])) + (
            " …" if len(cause.frames) > _MOST_FRAMES else ""
        )
        for text, color in (
            (cause.sentence, INK.name),
            (say("traffic.finding.frames", frames=frames) if frames else "", INK.number),
            (say("traffic.finding.advice", advice=cause.advice) if cause.advice else "", INK.good),
            (say("traffic.finding.source", source=cause.source) if cause.source else "", INK.dim),
        ):
            if text:
                yield from (f"  {color}{line}{INK.reset}" for line in wrapped(text, width))
