"""Widgets for text in the colours of the theme, and for input that is checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input, Static

from bcapscope.render.escape import printable
from bcapscope.tui.app import app_of
from bcapscope.tui.ink import styled_text
from bcapscope.tui.reader_language import full_error_text


class InkedText(Static):
    """Shows text that was rendered with `ink.INK`, and redraws the text when the theme changes."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes, markup=False)
        self._source_text = ""

    def show_text(self, text: str, *, layout: bool = True) -> None:
        """Show a text that may contain ink marks (see `bcapscope.tui.ink`). `layout` must be True if the size
        of the text may have changed.
        """
        if text != self._source_text:
            self._source_text = text
            self._draw(layout)

    def _draw(self, layout: bool) -> None:
        self.update(styled_text(self._source_text, app_of(self).text_styles), layout=layout)

    def notify_style_update(self) -> None:
        super().notify_style_update()
        if self.is_mounted:
            self._draw(layout=False)


class CheckedInput(Vertical):
    """An input line that checks its text while the user types. It posts messages only for valid text."""

    @dataclass
    class Typed(Message):
        """The user typed valid text, or emptied the line. If the line is empty, `parsed` is None."""

        line: CheckedInput
        text: str
        parsed: object

        @property
        def control(self) -> CheckedInput:
            return self.line

    class Entered(Typed):
        """The user pressed Enter on valid text or an empty line. Because `Entered` is a subclass of `Typed`,
        Textual also calls the handlers of `Typed`.
        """

    def __init__(self, name: str, parse: Callable[[str], object], hint: str, caption: str = "") -> None:
        """`name` is the id of the input field; this widget has the id ``<name>-line``. `parse` never gets an
        empty text. For invalid text, `parse` raises a `ValueError`, whose text the widget shows.
        """
        super().__init__(id=f"{name}-line")
        self.field = Input(placeholder=hint, id=name, select_on_focus=False)
        self._error = Static(id=f"{name}-error", classes="checked-error")
        self._parse, self._caption = parse, caption

    def compose(self) -> ComposeResult:
        with Horizontal(classes="checked-row"):
            if self._caption:
                yield Static(Text(f" {self._caption} "), classes="checked-caption")
            yield self.field
        yield self._error

    def set_text(self, text: str) -> None:
        """Set the text without posting a message."""
        with self.field.prevent(Input.Changed):
            self.field.value = text
        self.field.cursor_position = len(text)
        self._show_problem("")

    def on_input_changed(self, event: Input.Changed) -> None:
        self._check_text(event.value.strip(), self.Typed)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        # check the text again, because the result of `parse` can depend on more than the text
        self._check_text(event.value.strip(), self.Entered)

    def _check_text(self, text: str, message: type[Typed]) -> None:
        try:
            made = self._parse(text) if text else None
        except ValueError as wrong:
            self._show_problem(full_error_text(wrong))
            return
        self._show_problem("")
        self.post_message(message(self, text, made))

    def _show_problem(self, wrong: str) -> None:
        self._error.update(Text("\n".join(map(printable, wrong.split("\n")))))
        self._error.display = bool(wrong)
        self.field.set_class(bool(wrong), "-invalid")
