"""Bars of one line, with clickable texts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual.app import RenderResult
from textual.reactive import var
from textual.screen import Screen
from textual.widget import Widget

from bcapscope.messages.message import has_message
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label


class ClickBar(Widget):
    """Base class of the bars. A subclass renders each text in a style that `style_for` returns."""

    auto_links = var(False)  # Textual's own link style would draw clickable text in other colours

    def style_for(self, name: str, action: str) -> Style:
        """Return the style of the component class `name`. A click on text in this style runs `action`."""
        return self.get_component_rich_style(name) + Style(meta={"@click": action})


class TopBar(ClickBar):
    """Shows the screens with their keys, and `BcapApp.status` at the right. A click opens a screen."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"topbar--title", "topbar--here", "topbar--there"}

    def on_mount(self) -> None:
        self.watch(self.app, "status", self._show_status)

    def _show_status(self) -> None:
        self.refresh()

    def render(self) -> RenderResult:
        app = app_of(self)
        status = Text.assemble(*((text, app.text_styles.get(ink, "")) for text, ink in app.status))
        left = Text(" bcapscope ", style=self.get_component_rich_style("topbar--title"), end="")
        for entry in app.screen_entries:
            kind = "topbar--here" if entry.mode == app.current_mode else "topbar--there"
            style = self.style_for(kind, f"app.switch_mode({entry.mode!r})")
            left.append(f" {entry.key.upper()} {label(entry.name)} ", style=style)
        space = self.size.width - left.cell_len - status.cell_len
        if space < 0:
            left.truncate(max(0, self.size.width - status.cell_len))
        return Text.assemble(left, " " * max(0, space), status, no_wrap=True, end="")


_ALWAYS_SHOWN = ("f12", "f1", "ctrl+p")  # HALT, help, the command palette


class KeyBar(ClickBar):
    """Shows as many keys as fit, starting with the focused widget's keys. A click presses the key."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"keybar--key", "keybar--text"}

    def on_mount(self) -> None:
        assert isinstance(self.screen, Screen)
        self.screen.bindings_updated_signal.subscribe(self, lambda _: self.refresh())

    def render(self) -> RenderResult:
        pieces = {
            key: self._make_piece(key, self.app.get_key_display(active.binding), active.binding.description)
            for key, active in self.screen.active_bindings.items()
            if active.binding.show and has_message(active.binding.description)
        }
        always = [pieces.pop(key) for key in tuple(pieces) if key in _ALWAYS_SHOWN]
        room = self.size.width - sum(piece.cell_len for piece in always)
        bar = Text(no_wrap=True, end="", overflow="ellipsis")
        for piece in pieces.values():
            room -= piece.cell_len
            if room < 0:
                break
            bar.append_text(piece)
        return bar.append_text(Text().join(always))

    def _make_piece(self, key: str, key_text: str, name: str) -> Text:
        action = f"app.simulate_key({key!r})"
        return Text.assemble(
            (f" {key_text} ", self.style_for("keybar--key", action)),
            (f"{label(name)} ", self.style_for("keybar--text", action)),
        )


class ViewBar(ClickBar):
    """Shows key, name and number of rows of each view, and the screen's progress. A click opens a view."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {f"viewbar--{part}" for part in ("here", "there", "key", "state")}

    def __init__(self, views: Mapping[str, str], *, id: str | None = None) -> None:
        """`views` maps the name of each view to the id of a label."""
        super().__init__(id=id)
        self._views = views
        self._current_view = ""
        self._counts: Mapping[str, str] = {}
        self._states: Sequence[str] = ()

    def show_counts(self, current_view: str, counts: Mapping[str, str], states: Sequence[str]) -> None:
        """The rest of the bar shows the first text of `states` that is short enough."""
        if (current_view, counts, states) != (self._current_view, self._counts, self._states):
            self._current_view, self._counts, self._states = current_view, counts, states
            self.refresh()

    def render(self) -> RenderResult:
        bar = Text(no_wrap=True, end="")
        for number, (view, name) in enumerate(self._views.items(), 1):
            count, action = self._counts.get(view, ""), f"screen.view({view!r})"
            key_style, text_style = ("here", "here") if view == self._current_view else ("key", "there")
            text = f"{label(name)} {count} " if count else f"{label(name)} "
            bar.append(f" {number} ", self.style_for(f"viewbar--{key_style}", action))
            bar.append(text, self.style_for(f"viewbar--{text_style}", action))
        space = self.size.width - bar.cell_len
        state = next((f"{text} " for text in self._states if cell_len(text) < space), "")
        bar.append(" " * (space - cell_len(state)))
        return bar.append(state, self.get_component_rich_style("viewbar--state"))
