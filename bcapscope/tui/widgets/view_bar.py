"""The names and counts of a screen's views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual.events import Click
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from bcapscope.tui.reader_language import label


class ViewBar(Widget):
    """Shows the names of views with keys and counts, and progress at the right."""

    COMPONENT_CLASSES = {"viewbar--here", "viewbar--there", "viewbar--key", "viewbar--state"}  # noqa: RUF012 - as Textual has it

    class ViewWanted(Message):
        def __init__(self, view: str) -> None:
            super().__init__()
            self.view = view

    def __init__(self, views: Sequence[tuple[str, str]], *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._views = tuple(views)
        self._current_view = self._views[0][0]
        self._counts: Mapping[str, str] = {}
        self._states: Sequence[str] = ()
        self._styles: dict[str, Style] = {}

    def show_counts(self, current_view: str, counts: Mapping[str, str], states: Sequence[str]) -> None:
        """Show the current view, the counts by view, and the first of several state texts that fits."""
        if (current_view, counts, states) != (self._current_view, self._counts, self._states):
            self._current_view, self._counts, self._states = current_view, counts, states
            self.refresh()

    def _view_labels(self) -> list[tuple[str, str, str]]:
        found = []
        for number, (view, name) in enumerate(self._views, 1):
            count = self._counts.get(view, "")
            found.append((view, f" {number} ", f"{label(name)}{f' {count}' if count else ''} "))
        return found

    def notify_style_update(self) -> None:
        self._styles.clear()
        super().notify_style_update()

    def _style(self, name: str) -> Style:
        """Return a style, "" for the bar's own; cached per theme, since counts change often."""
        if name not in self._styles:
            own = self.get_component_rich_style(f"viewbar--{name}") if name else self.rich_style
            self._styles[name] = own
        return self._styles[name]

    def render_line(self, y: int) -> Strip:
        """Render the bar, and omit what does not fit."""
        width = self.size.width
        bar: list[Segment] = []
        for view, key, text in self._view_labels():
            is_here = view == self._current_view
            bar.append(Segment(key, self._style("here" if is_here else "key")))
            bar.append(Segment(text, self._style("here" if is_here else "there")))
        space = width - sum(segment.cell_length for segment in bar)
        state = next((f"{text} " for text in self._states if cell_len(text) < space), "")
        if state:
            bar.append(Segment(" " * (space - cell_len(state)), self._style("")))
            bar.append(Segment(state, self._style("state")))
        return Strip(bar).adjust_cell_length(width, self._style(""))

    def on_click(self, event: Click) -> None:
        at = 0
        for view, key, text in self._view_labels():
            width = cell_len(key + text)
            if at <= event.x < at + width:
                self.post_message(self.ViewWanted(view))
            at += width
