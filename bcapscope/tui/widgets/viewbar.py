"""The views of a screen: which is shown, how much is in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.text import Text
from textual.app import RenderResult
from textual.events import Click
from textual.message import Message
from textual.widget import Widget

from bcapscope.tui.words import say


class ViewBar(Widget):
    """Shows the names of views with their keys and counts, and at the right how reading goes."""

    COMPONENT_CLASSES = {"viewbar--here", "viewbar--there", "viewbar--key", "viewbar--state"}  # noqa: RUF012 - as Textual has it

    class Wanted(Message):
        """A view was clicked."""

        def __init__(self, view: str) -> None:
            super().__init__()
            self.view = view

    def __init__(self, views: Sequence[tuple[str, str]], *, id: str | None = None) -> None:
        """Take the views: for the program, and the key of the name of each."""
        super().__init__(id=id)
        self._views = tuple(views)
        self._here = self._views[0][0]
        self._counts: Mapping[str, str] = {}
        self._states: Sequence[str] = ()

    def show(self, here: str, counts: Mapping[str, str], states: Sequence[str]) -> None:
        """Show where one is, the counts by view, and of several texts on the state the first that fits."""
        if (here, counts, states) != (self._here, self._counts, self._states):
            self._here, self._counts, self._states = here, counts, states
            self.refresh()

    def _texts(self) -> list[tuple[str, str, str]]:
        """Return view, key and label of each."""
        found = []
        for number, (view, name) in enumerate(self._views, 1):
            count = self._counts.get(view, "")
            found.append((view, f" {number} ", f"{say(name)}{f' {count}' if count else ''} "))
        return found

    def render(self) -> RenderResult:
        """Write the bar; what there is no room for is left out."""
        bar = Text(no_wrap=True, end="", overflow="crop")
        key_style = self.get_component_rich_style("viewbar--key")
        for view, key, label in self._texts():
            style = self.get_component_rich_style("viewbar--here" if view == self._here else "viewbar--there")
            bar.append(key, style=key_style if view != self._here else style)
            bar.append(label, style=style)
        for text in self._states:
            state = Text(f"{text} ", style=self.get_component_rich_style("viewbar--state"))
            space = self.size.width - bar.cell_len - state.cell_len
            if space >= 0:
                bar.append(" " * space)
                bar.append_text(state)
                break
        return bar

    def on_click(self, event: Click) -> None:
        """Tell which view was clicked."""
        at = 0
        for view, key, label in self._texts():
            width = Text(key + label).cell_len
            if at <= event.x < at + width:
                self.post_message(self.Wanted(view))
            at += width
