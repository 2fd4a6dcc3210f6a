"""Small widgets for the forms of the Tester."""

from __future__ import annotations

from typing import Literal

from textual.widgets import Button, Checkbox, Label

from bcapscope.tui.reader_language import label


class Caption(Label):
    """A word before a field; `key` is the label key of the word."""

    def __init__(self, key: str) -> None:
        super().__init__(label(key), markup=False)


class FormButton(Button):
    """A button of one line; `key` is the label key of its text."""

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
        self._update_mark()

    def watch_value(self) -> None:
        self._update_mark()
        super().watch_value()

    def _update_mark(self) -> None:
        self.BUTTON_INNER = "X" if self.value else " "
