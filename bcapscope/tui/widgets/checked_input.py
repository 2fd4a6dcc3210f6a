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


class CheckedInput(Vertical):
    """Reads what is typed, and tells of it only where it makes sense."""

    class Typed(Message):
        """Something that makes sense was typed, or all was taken away.

        Attributes:
            line: which line it is.
            text: what stands there, without blanks at its ends.
            parsed: what was made of it; None for an empty line.
        """

        def __init__(self, line: CheckedInput, text: str, parsed: object) -> None:
            super().__init__()
            self.line, self.text, self.parsed = line, text, parsed

        @property
        def control(self) -> CheckedInput:
            """The line."""
            return self.line

    class Entered(Typed):
        """Enter was pressed on what makes sense, or on an empty line; who heeds `Typed` is told as well."""

    def __init__(self, name: str, parse: Callable[[str], object], hint: str, caption: str = "") -> None:
        """Take what the line is for.

        Args:
            name: id of the field; the line's own is the name with ``-line`` behind it.
            parse: makes something of a text that is not empty; raises `ValueError`, whose text is shown,
                where it makes no sense.
            hint: what stands in an empty field.
            caption: what stands before it; "" for nothing.
        """
        super().__init__(id=f"{name}-line")
        self._field, self._parse, self._hint, self._caption = name, parse, hint, caption

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

    def set_text(self, text: str) -> None:
        """Put a text there without telling of it: it is not what somebody typed."""
        field = self.field
        with field.prevent(Input.Changed):
            field.value = text
        field.cursor_position = len(text)
        self._show_problem("")

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check what was typed at once."""
        event.stop()
        self._check_text(event.value.strip(), self.Typed)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Check it once more: what it depends on may have changed."""
        event.stop()
        self._check_text(event.value.strip(), self.Entered)

    def _check_text(self, text: str, message: type[Typed]) -> None:
        try:
            made = self._parse(text) if text else None
        except ValueError as wrong:
            self._show_problem(str(wrong))
            return
        self._show_problem("")
        self.post_message(message(self, text, made))

    def _show_problem(self, wrong: str) -> None:
        error = self.query_one(f"#{self._field}-error", Static)
        reason, *where = wrong.split("\n")
        error.update(Text("\n".join(map(printable, (told(reason), *where)))))
        error.display = bool(wrong)
        self.field.set_class(bool(wrong), "-invalid")
