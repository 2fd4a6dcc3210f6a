"""A list of lines of text that was rendered elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.tui.widgets.lines import Lines


class TextPage(Lines):
    """Shows rendered lines; the cursor keeps its position when the lines change."""

    def __init__(self, lines: Sequence[str] = (), *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._lines = list(lines)

    def show_lines(self, lines: Sequence[str]) -> None:
        if self._lines != lines:
            self._lines = list(lines)
            self.reset_lines(self.cursor)

    @property
    def count(self) -> int:
        return len(self._lines)

    def line(self, index: int) -> str:
        return self._lines[index]
