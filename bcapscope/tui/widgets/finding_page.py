"""Show findings, each consequence below its cause."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.events import Resize

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Language
from bcapscope.protocol.text_format import display_width
from bcapscope.render.columns import wrap_text
from bcapscope.render.findings import diagnosis_summary as summed_up
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import current_language, label, reader_words
from bcapscope.tui.traffic_processes.process_messages import NO_ANALYSIS, ShownFinding, TrafficAnalysis
from bcapscope.tui.widgets.lines import ItemList

_INDENT_STEP, _MAX_DEPTH = 3, 4
_MAX_WIDTH, _MIN_WIDTH = 120, 30
_MAX_FRAMES = 12


class FindingPage(ItemList[tuple[str, int]]):
    """Shows findings as paragraphs. An item is a text line and its finding's number; 0 for the summary."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "choose", "findings.choose")]
    _analysis = NO_ANALYSIS

    def show_analysis(self, analysis: TrafficAnalysis) -> None:
        if analysis != self._analysis:
            self._analysis = analysis
            self._update_lines()

    def current_finding(self) -> int | None:
        """Return the number of the finding under the cursor; 1 on the summary, None without findings."""
        return (self.current_item[1] or 1) if self.current_item and self._analysis.findings else None

    def go_to_finding(self, number: int) -> None:
        for index, (_, each) in enumerate(self.items):
            if each == number:
                self.move_cursor_to(index)
                return

    def item_line(self, item: tuple[str, int]) -> str:
        return item[0]

    def on_resize(self, event: Resize) -> None:
        self._update_lines()

    @property
    def _columns(self) -> int:
        """Number of columns for text; before the first layout, the expected number."""
        return self.size.width or self.app.size.width - self.scrollbar_size_vertical

    def _update_lines(self) -> None:
        here = self.current_finding()
        found, lines = self._analysis.findings, []
        if self._analysis is not NO_ANALYSIS:
            severities = [cause.severity for cause in found]
            summary = summed_up(severities, self._analysis.examined, INK, reader_words())
            lines = [(f" {line}", 0) for line in wrap_text(summary, max(_MIN_WIDTH, self._columns - 2))]
            lines.append(("", 0))
        depths: list[int] = []
        for number, cause in enumerate(found, 1):
            depths.append(depths[cause.consequence_of - 1] + 1 if cause.consequence_of else 0)
            indent = " " * _INDENT_STEP * min(depths[-1], _MAX_DEPTH)
            lines += [
                (f" {indent}{line}", number) for line in self._finding_lines(number, cause, len(indent))
            ]
            lines.append(("", number))
        self.show_items(lines or [(f" {label('traffic.empty.findings')}", 0)])
        if here is not None and here != self.current_finding():
            self.go_to_finding(here)

    def _finding_lines(self, number: int, cause: ShownFinding, indent: int) -> Iterator[str]:
        width = max(_MIN_WIDTH, min(self._columns - indent - 4, _MAX_WIDTH))
        shade = INK.bad if cause.severity == Severity.ERROR else INK.name
        title = label(f"rule.{cause.rule}.title") if current_language() is Language.JAPANESE else cause.rule
        head = title
        if cause.consequence_of:
            head += f", {label('traffic.finding.follows', number=cause.consequence_of)}"
        severity = label(f"severity.{cause.severity}")
        lead = display_width(f"{number} {severity} ")
        first, *rest = wrap_text(head, width + 2 - lead)
        yield f"{INK.number}{number}{INK.reset} {shade}{severity}{INK.reset} {first}"
        yield from (f"{' ' * lead}{line}" for line in rest)
        frames = ", ".join(map(str, cause.frames[:_MAX_FRAMES])) + (
            " …" if len(cause.frames) > _MAX_FRAMES else ""
        )
        for text, color in (
            (cause.sentence[current_language()], INK.name),
            (label("traffic.finding.frames", frames=frames) if frames else "", INK.number),
            (label("traffic.finding.advice", advice=cause.advice[current_language()]), INK.good),
            (label("traffic.finding.source", source=cause.source) if cause.source else "", INK.dim),
            (cause.rule if title != cause.rule else "", INK.dim),
        ):
            if text:
                yield from (f"  {color}{line}{INK.reset}" for line in wrap_text(text, width))
