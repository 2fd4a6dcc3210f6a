"""A line to type in; what is wrong with what was typed stands below it."""

from __future__ import annotations

from collections.abc import Callable

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input, Static

from bcapscope.render.escape import printable
from bcapscope.tui.words import told


class CheckedLine(Vertical):
    """Reads what is typed, and tells of it only where it makes sense."""

    class Typed(Message):
        """Something that makes sense was typed, or all was taken away.

        Attributes:
            line: which line it is.
            text: what stands there, without blanks at its ends.
            made: what was made of it; None for an empty line.
        """

        def __init__(self, line: CheckedLine, text: str, made: object) -> None:
            super().__init__()
            self.line, self.text, self.made = line, text, made

        @property
        def control(self) -> CheckedLine:
            """The line."""
            return self.line

    class Entered(Typed):
        """Enter was pressed on what makes sense, or on an empty line; who heeds `Typed` is told as well."""

    def __init__(self, name: str, read: Callable[[str], object], hint: str, caption: str = "") -> None:
        """Take what the line is for.

        Args:
            name: id of the field; the line's own is the name with ``-line`` behind it.
            read: makes something of a text that is not empty; raises `ValueError`, whose text is shown, where
                it makes no sense.
            hint: what stands in an empty field.
            caption: what stands before it; "" for nothing.
        """
        super().__init__(id=f"{name}-line")
        self._field, self._read, self._hint, self._caption = name, read, hint, caption

    def compose(self) -> ComposeResult:
        """Put the field above the place for what is wrong."""
        with Horizontal(classes="checked-row"):
            if self._caption:
                yield Static(Text(f" {self._caption} "), classes="checked-caption")
            yield Input(placeholder=self._hint, id=self._field, select_on_focus=False)
        yield Static(id=f"{self._field}-error", classes="checked-error")

    @property
    def field(self) -> Input:
        """Where it is typed."""
        return self.query_one(f"#{self._field}", Input)

    def propose(self, text: str) -> None:
        """Put a text there without telling of it: it is not what somebody typed."""
        field = self.field
        with field.prevent(Input.Changed):
            field.value = text
        field.cursor_position = len(text)
        self._tell("")

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check what was typed at once."""
        event.stop()
        self._take(event.value.strip(), self.Typed)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Check it once more: what it depends on may have changed."""
        event.stop()
        self._take(event.value.strip(), self.Entered)

    def _take(self, text: str, message: type[Typed]) -> None:
        try:
            made = self._read(text) if text else None
        except ValueError as wrong:
            self._tell(str(wrong))
            return
        self._tell("")
        self.post_message(message(self, text, made))

    def _tell(self, wrong: str) -> None:
        error = self.query_one(f"#{self._field}-error", Static)
        reason, *where = wrong.split("\n")
        error.update(Text("\n".join(map(printable, (told(reason), *where)))))
        error.display = bool(wrong)
        self.field.set_class(bool(wrong), "-invalid")
