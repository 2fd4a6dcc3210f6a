"""Rendered text, in the colours of the theme."""

from __future__ import annotations

from textual.widgets import Static

from bcapscope.tui.app import scope_of
from bcapscope.tui.ink import inked


class InkedText(Static):
    """Shows what was rendered with `ink.INK`, and draws it anew in the colours of another theme."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        """Begin empty."""
        super().__init__(id=id, classes=classes, markup=False)
        self._marked = ""

    def write(self, text: str, *, layout: bool = True) -> None:
        """Show a text.

        Args:
            text: with the marks of its colours.
            layout: its size may be another than before.
        """
        self._marked = text
        self.update(inked(text, scope_of(self).inks), layout=layout)

    def notify_style_update(self) -> None:
        """Draw in the colours of a new theme."""
        super().notify_style_update()
        if self.is_mounted:
            self.write(self._marked, layout=False)
