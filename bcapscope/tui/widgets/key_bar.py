"""The bar below all screens: the keys that have an effect at the cursor."""

from __future__ import annotations

from collections.abc import Iterator

from rich.text import Text
from textual.app import RenderResult
from textual.events import Click
from textual.screen import Screen
from textual.widget import Widget

from bcapscope.messages.message import has_message
from bcapscope.tui.reader_language import label

_ALWAYS_SHOWN = ("f12", "f1", "ctrl+p")
"""Keys that are always shown: HALT, help, the command palette."""


class KeyBar(Widget):
    """Shows keys and their actions, as many as fit; a click runs the action.

    Keys of the focused widget come first, those of the application last. Those in `_ALWAYS_SHOWN` always have
    room.
    """

    COMPONENT_CLASSES = {"keybar--key", "keybar--text"}  # noqa: RUF012 - as Textual has it

    def on_mount(self) -> None:
        assert isinstance(self.screen, Screen)
        self.screen.bindings_updated_signal.subscribe(self, lambda _: self.refresh())

    def _visible_keys(self) -> Iterator[tuple[str, str]]:
        """Yield keys and their actions, as many as fit."""
        found = [
            (self.app.get_key_display(active.binding), label(active.binding.description), key)
            for key, active in self.screen.active_bindings.items()
            if active.binding.show and has_message(active.binding.description)
        ]
        always = [each for each in found if each[2] in _ALWAYS_SHOWN]
        room = self.size.width - sum(_width(key, text) for key, text, _ in always)
        for key, text, name in found:
            if name in _ALWAYS_SHOWN:
                continue
            room -= _width(key, text)
            if room < 0:
                break
            yield name, f" {key} {text} "
        for key, text, name in always:
            yield name, f" {key} {text} "

    def render(self) -> RenderResult:
        bar = Text(no_wrap=True, end="", overflow="ellipsis")
        key_style = self.get_component_rich_style("keybar--key")
        text_style = self.get_component_rich_style("keybar--text")
        for _, text in self._visible_keys():
            key, _, rest = text[1:].partition(" ")
            bar.append(f" {key} ", style=key_style)
            bar.append(rest, style=text_style)
        return bar

    def on_click(self, event: Click) -> None:
        at = 0
        for name, text in self._visible_keys():
            width = Text(text).cell_len
            if at <= event.x < at + width:
                self.app.simulate_key(name)
                return
            at += width


def _width(key: str, text: str) -> int:
    return Text(f" {key} {text} ").cell_len
