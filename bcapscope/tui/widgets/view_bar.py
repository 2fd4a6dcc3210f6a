"""The bar with the names of a screen's views and the number of rows in each view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from rich.cells import cell_len
from rich.segment import Segment
from textual.strip import Strip

from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.click_bar import ClickBar


class ViewBar(ClickBar):
    """Shows the names of views with keys and counts, and the progress at the right.

    A click shows the view.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "viewbar--here",
        "viewbar--there",
        "viewbar--key",
        "viewbar--state",
    }

    def __init__(self, views: Sequence[tuple[str, str]], *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._views = tuple(views)
        self._current_view = self._views[0][0]
        self._counts: Mapping[str, str] = {}
        self._states: Sequence[str] = ()

    def show_counts(self, current_view: str, counts: Mapping[str, str], states: Sequence[str]) -> None:
        """Show which view is visible, the counts by view, and the first of several state texts that fits."""
        if (current_view, counts, states) != (self._current_view, self._counts, self._states):
            self._current_view, self._counts, self._states = current_view, counts, states
            self.refresh()

    def render_line(self, y: int) -> Strip:
        """Render the bar, and omit texts that do not fit."""
        width = self.size.width
        bar: list[Segment] = []
        for number, (view, name) in enumerate(self._views, 1):
            count = self._counts.get(view, "")
            key_style, text_style = ("here", "here") if view == self._current_view else ("key", "there")
            for style, text in (
                (key_style, f" {number} "),
                (text_style, f"{label(name)} {count} " if count else f"{label(name)} "),
            ):
                bar.append(Segment(text, self.style_for(f"viewbar--{style}", f"screen.view({view!r})")))
        space = width - sum(segment.cell_length for segment in bar)
        state = next((f"{text} " for text in self._states if cell_len(text) < space), "")
        if state:
            bar.append(Segment(" " * (space - cell_len(state)), self.rich_style))
            bar.append(Segment(state, self.get_component_rich_style("viewbar--state")))
        return Strip(bar).adjust_cell_length(width, self.rich_style)
