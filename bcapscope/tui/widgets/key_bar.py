"""The bar below all screens: shows the keys that have an effect at the cursor."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual.app import RenderResult
from textual.screen import Screen

from bcapscope.messages.message import has_message
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.click_bar import ClickBar

_ALWAYS_SHOWN = ("f12", "f1", "ctrl+p")
"""Actions whose keys the bar always shows: HALT, help, the command palette."""


class KeyBar(ClickBar):
    """Shows keys and their actions, as many as fit; a click on a key runs its action.

    Keys of the focused widget come first, and keys of the application last. The bar always has room for the
    keys in `_ALWAYS_SHOWN`.
    """

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
