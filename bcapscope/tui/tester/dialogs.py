"""Small dialogs: questions with answers to choose from."""

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

_ARROW_BINDINGS = (
    Binding("left", "app.focus_previous", show=False),
    Binding("right", "app.focus_next", show=False),
)
"""The arrow keys move between the answers, which are side by side."""


class ArmDialog(ModalScreen[bool]):
    """Asks the user whether to arm, and shows which robot could move.

    The answer "no" has the focus at the start.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,n", "dismiss(False)", "tester.arm.no", key_display="esc"),
        *_ARROW_BINDINGS,
    ]

    def __init__(self, facts: list[str]) -> None:
        """Store the facts about controller and robot that the dialog shows, as escaped lines."""
        super().__init__()
        self._facts = facts

    def compose(self) -> ComposeResult:
        """Arrange the answers below the facts."""
        with Vertical(classes="dialog -warning") as box:
            box.border_title = label("tester.arm.title")
            yield Static("\n".join(self._facts), markup=False, id="facts")
            yield Static(label("tester.arm.warning"), markup=False)
            with Horizontal(classes="answers"):
                yield Button(label("tester.arm.no"), compact=True, id="no")
                yield Button(label("tester.arm.yes"), compact=True, variant="error", id="yes")

    def on_mount(self) -> None:
        """Focus the answer "no", so that Enter does not arm."""
        self.query_one("#no").focus()

    @on(Button.Pressed)
    def _answer(self, message: Button.Pressed) -> None:
        self.dismiss(message.button.id == "yes")


class ChoiceDialog(ModalScreen[str | None]):
    """Asks the user to choose. The first choice changes nothing and has the focus at the start."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        *_ARROW_BINDINGS,
    ]

    def __init__(self, facts: list[str], choices: Sequence[str]) -> None:
        """Store the escaped facts and the choices."""
        super().__init__()
        self._facts, self._choices = facts, tuple(choices)

    def compose(self) -> ComposeResult:
        """Arrange the choices below the facts."""
        with Vertical(classes="dialog -warning"):
            yield Static("\n".join(self._facts), markup=False, id="facts")
            with Horizontal(classes="answers"):
                for at, choice in enumerate(self._choices):
                    yield Button(
                        label(f"tester.answer.{choice}"),
                        compact=True,
                        id=f"choice{at}",
                        variant="error" if at else "default",
                    )

    def on_mount(self) -> None:
        """Focus the first choice, which changes nothing, so that Enter is harmless."""
        self.query_one("#choice0").focus()

    @on(Button.Pressed)
    def _answer(self, message: Button.Pressed) -> None:
        self.dismiss(self._choices[int((message.button.id or "choice0").removeprefix("choice"))])
