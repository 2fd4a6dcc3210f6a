"""A caption before a widget, as the forms of the Tester have them."""

from __future__ import annotations

from textual.widgets import Label

from bcapscope.tui.words import say


class Caption(Label):
    """A word before a field; `key` is that of the word in the catalogue."""

    def __init__(self, key: str) -> None:
        super().__init__(say(key), markup=False)
