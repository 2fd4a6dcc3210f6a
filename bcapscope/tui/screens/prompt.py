"""One question, answered in one line."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, Static

from bcapscope.tui.words import say


class Prompt(ModalScreen[str | None]):
    """Asks for a text; gives it, or None where the user thought better of it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "cancel", "prompt.cancel", key_display="esc"),
    ]

    def __init__(self, title: str, hint: str, value: str = "") -> None:
        """Take what is asked, what kind of answer is wanted, and what stands there at first."""
        super().__init__()
        self._question, self._hint, self._value = title, hint, value

    def compose(self) -> ComposeResult:
        """Show the question above the field, and below it what is wanted."""
        with Vertical(id="prompt"):
            yield Static(Text(self._question), id="prompt-title")
            yield Input(self._value, id="prompt-input")
            yield Static(
                Text(f"{self._hint}   ⏎ {say('prompt.accept')}   esc {say('prompt.cancel')}"),
                id="prompt-hint",
            )

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Give the answer."""
        self.dismiss(event.value)

    def action_cancel(self) -> None:
        """Give none."""
        self.dismiss(None)
