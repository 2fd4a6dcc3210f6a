"""A caption before a widget in the forms of the Tester."""

from __future__ import annotations

from textual.widgets import Label

from bcapscope.tui.reader_language import label


class Caption(Label):
    """A word before a field; `key` is the label key of the word."""

    def __init__(self, key: str) -> None:
        super().__init__(label(key), markup=False)
