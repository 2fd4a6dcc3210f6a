"""Text that was rendered elsewhere, as a list of lines."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.tui.widgets.lines import Lines


class TextPage(Lines):
    """Shows lines as they are; the cursor stays where it is when they are others."""

    def __init__(self, lines: Sequence[str] = (), *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._lines = list(lines)

    def show_lines(self, lines: Sequence[str]) -> None:
        """Show other lines."""
        if self._lines != lines:
            self._lines = list(lines)
            self.reset_lines(self.cursor)

    @property
    def count(self) -> int:
        """How many lines there are."""
        return len(self._lines)

    def line(self, index: int) -> str:
        """Return a line."""
        return self._lines[index]
