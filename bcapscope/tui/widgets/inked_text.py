"""Shows rendered text in the colours of the theme."""

from __future__ import annotations

from textual.widgets import Static

from bcapscope.tui.app import app_of
from bcapscope.tui.ink import styled_text


class InkedText(Static):
    """Shows text that was rendered with `ink.INK`, and redraws the text when the theme changes."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes, markup=False)
        self._source_text = ""

    def show_text(self, text: str, *, layout: bool = True) -> None:
        """Show a text with ink marks; `layout` says whether the size of the text may have changed."""
        self._source_text = text
        self.update(styled_text(text, app_of(self).text_styles), layout=layout)

    def notify_style_update(self) -> None:
        super().notify_style_update()
        if self.is_mounted:
            self.show_text(self._source_text, layout=False)
