"""Dialogs with a few buttons to choose from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Static

from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.form_widgets import FormButton


class ChoiceDialog(ModalScreen[str | None]):
    """Asks the user to choose. The first choice changes nothing, and Enter chooses it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("left", "app.focus_previous", show=False),
        Binding("right", "app.focus_next", show=False),
    ]
    LABELS = "tester.answer"
    """Start of the label keys of the choices; a point and the choice follow."""

    def __init__(self, lines: Sequence[str], choices: Sequence[str]) -> None:
        """Store the facts and the question, as escaped lines, and the choices."""
        super().__init__()
        self._lines, self._choices = lines, choices

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -warning"):
            yield Static("\n".join(self._lines), markup=False, id="facts")
            with Horizontal(classes="answers"):
                for at, choice in enumerate(self._choices):
                    yield FormButton(f"{self.LABELS}.{choice}", "error" if at else "default", id=choice)

    def on_mount(self) -> None:
        self.query_one(f"#{self._choices[0]}").focus()

    @on(Button.Pressed)
    def _answer(self, message: Button.Pressed) -> None:
        self.dismiss(message.button.id)


class ArmDialog(ChoiceDialog):
    """Asks whether to arm, with the result ``yes`` or ``no``; the facts say which robot could move."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("n", "dismiss(None)", show=False)]
    LABELS = "tester.arm"

    def __init__(self, facts: Sequence[str]) -> None:
        super().__init__([*facts, "", label("tester.arm.warning")], ("no", "yes"))

    def on_mount(self) -> None:
        super().on_mount()
        self.query_one(".dialog").border_title = label("tester.arm.title")
