"""Small widgets for the forms of the Tester."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from rich.text import Text
from textual.app import RenderResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.message import Message
from textual.reactive import reactive
from textual.widgets import Button, Checkbox, Label

from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.bars import ClickBar


class Caption(Label):
    def __init__(self, key: str) -> None:
        super().__init__(label(key), markup=False)


class Box(Vertical):
    """A border around a group of fields. `title` is the id of the label in the border."""

    def __init__(self, title: str, *, id: str) -> None:
        super().__init__(id=id, classes="box")
        self.border_title = label(title)


class FormButton(Button):
    """A button that is one line high. `key` is the id of the label that the button shows."""

    def __init__(
        self,
        key: str,
        variant: Literal["default", "primary", "success", "warning", "error"] = "default",
        *,
        id: str | None = None,
        classes: str | None = None,
        disabled: bool = False,
    ) -> None:
        super().__init__(label(key), variant, id=id, classes=classes, disabled=disabled, compact=True)


class TickBox(Checkbox):
    """A check box whose state is visible even without colours."""

    def __init__(self, label: str, value: bool = False, *, id: str | None = None) -> None:
        super().__init__(label, value, compact=True, id=id)

    @property
    def BUTTON_INNER(self) -> str:  # type: ignore[override]  # a class attribute in Textual
        return "X" if self.value else " "


class ChoiceRow(ClickBar, can_focus=True):
    """A row of names. The user chooses one name."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "step(-1)", "", show=False),
        Binding("right", "step(1)", "", show=False),
    ]
    COMPONENT_CLASSES: ClassVar[set[str]] = {"choice--chosen", "choice--other"}
    chosen: reactive[str] = reactive("", init=False)

    @dataclass
    class Chosen(Message):
        choice: ChoiceRow
        value: str

        @property
        def control(self) -> ChoiceRow:
            return self.choice

    def __init__(self, options: Sequence[tuple[str, str]], *, id: str | None = None) -> None:
        """`options` are the values, each with its label id. At the start, the first value is chosen."""
        super().__init__(id=id)
        self._options = tuple(options)
        self.set_reactive(ChoiceRow.chosen, self._options[0][0])

    def watch_chosen(self, value: str) -> None:
        self.post_message(self.Chosen(self, value))

    def render(self) -> RenderResult:
        text = Text(no_wrap=True, end="")
        for value, name in self._options:
            kind = "choice--chosen" if value == self.chosen else "choice--other"
            text.append(f" {label(name)} ", style=self.style_for(kind, f"choose({value!r})"))
        return text

    def action_step(self, by: int) -> None:
        values = [value for value, _ in self._options]
        self.chosen = values[(values.index(self.chosen) + by) % len(values)]

    def action_choose(self, value: str) -> None:
        self.chosen = value
