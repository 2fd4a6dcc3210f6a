"""Findings, each consequence under its cause; choosing one leads to its frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.events import Resize

from bcapscope.analysis.finding import Severity
from bcapscope.protocol.wording import display_width
from bcapscope.render.columns import wrapped
from bcapscope.render.verdict import verdict as summed_up
from bcapscope.tui.ink import INK
from bcapscope.tui.traffic.report import NOTHING, Cause, Verdict
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say, titled, told

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
        self._verdict = NOTHING
        self._lines: list[tuple[str, int]] = []

    def show(self, verdict: Verdict) -> None:
        """Show findings under the line that sums them up."""
        if verdict != self._verdict:
            self._verdict = verdict
            self._write()

    def finding(self) -> int | None:
        """Tell on which finding the cursor is, from 1; the first one where it is above them all."""
        if not self._lines or not self._verdict.findings:
            return None
        return self._lines[self.cursor][1] or 1

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

    @property
    def _columns(self) -> int:
        """Columns for text: as many as there will be, while it is not seen yet."""
        return self.size.width or self.app.size.width - self.scrollbar_size_vertical

    def _write(self) -> None:
        here = self.finding()
        found, self._lines = self._verdict.findings, []
        if self._verdict is not NOTHING:
            severities = [cause.severity for cause in found]
            summary = summed_up(severities, self._verdict.seen, INK, told)
            self._lines = [(f" {line}", 0) for line in wrapped(summary, max(_NARROWEST, self._columns - 2))]
            self._lines.append(("", 0))
        depths: list[int] = []
        for number, cause in enumerate(found, 1):
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
        width = max(_NARROWEST, min(self._columns - indent - 4, _WIDEST))
        shade = INK.bad if cause.severity == Severity.ERROR else INK.name
        follows = (
            f", {say('traffic.finding.follows', number=cause.consequence_of)}" if cause.consequence_of else ""
        )
        title = titled(cause.rule)
        severity = told(cause.severity)
        lead = display_width(f"{number} {severity} ")
        first, *rest = wrapped(f"{title}{follows}", width + 2 - lead)
        yield f"{INK.number}{number}{INK.reset} {shade}{severity}{INK.reset} {first}"
        yield from (f"{' ' * lead}{line}" for line in rest)
        frames = ", ".join(map(str, cause.frames[:_MOST_FRAMES])) + (
            " …" if len(cause.frames) > _MOST_FRAMES else ""
        )
        for text, color in (
            (told(cause.sentence), INK.name),
            (say("traffic.finding.frames", frames=frames) if frames else "", INK.number),
            (say("traffic.finding.advice", advice=told(cause.advice)) if cause.advice else "", INK.good),
            (say("traffic.finding.source", source=cause.source) if cause.source else "", INK.dim),
            (cause.rule if title != cause.rule else "", INK.dim),
        ):
            if text:
                yield from (f"  {color}{line}{INK.reset}" for line in wrapped(text, width))
