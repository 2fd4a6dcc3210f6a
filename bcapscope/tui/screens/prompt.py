"""A dialog with one question and one input line."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, Static

from bcapscope.tui.reader_language import label


class Prompt(ModalScreen[str | None]):
    """Asks for a text. The dialog returns the text that the user typed, or None if the user cancels."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "cancel", "prompt.cancel", key_display="esc")]

    def __init__(self, title: str, hint: str, value: str = "") -> None:
        super().__init__()
        self._question, self._hint, self._value = title, hint, value

    def compose(self) -> ComposeResult:
        with Vertical(id="prompt"):
            yield Static(Text(self._question), id="prompt-title")
            yield Input(self._value, id="prompt-input")
            yield Static(
                Text(f"{self._hint}   ⏎ {label('prompt.accept')}   esc {label('prompt.cancel')}".strip()),
                id="prompt-hint",
            )

    def on_input_submitted(self, event: Input.Submitted) -> None:
        self.dismiss(event.value)

    def action_cancel(self) -> None:
        self.dismiss(None)
