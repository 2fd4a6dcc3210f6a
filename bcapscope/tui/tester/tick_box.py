"""A check box whose state is visible even without colours."""

from __future__ import annotations

from textual.widgets import Checkbox


class TickBox(Checkbox):
    def __init__(self, label: str, value: bool = False, *, id: str | None = None) -> None:
        super().__init__(label, value, compact=True, id=id)
        self._update_mark()

    def watch_value(self) -> None:
        self._update_mark()
        super().watch_value()

    def _update_mark(self) -> None:
        self.BUTTON_INNER = "X" if self.value else " "
