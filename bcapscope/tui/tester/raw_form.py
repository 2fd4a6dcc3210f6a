"""The raw form: bytes in hex that are sent unchanged, or with corrected length and serial."""

from __future__ import annotations

from collections.abc import Iterable

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.events import Paste
from textual.widgets import Button, Input

from bcapscope.protocol.codec.frame import Frame, Problem, parse_datagram
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.tui.reader_language import label, reader_words
from bcapscope.tui.tester.form_widgets import Caption, FormButton, TickBox
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.tester.wanted_messages import RawWanted

MAX_DATAGRAM = 65_507
"""Maximum payload of a UDP datagram in bytes."""

_EXAMPLE = "01 10 00 00 00 01 00 00 00 02 00 00 00 00 00 04"


class BytesField(Input):
    """An input field for bytes in hex, which users often copy from several lines."""

    def on_paste(self, event: Paste) -> None:
        """Join the pasted lines; Textual's own handler then pastes the first line."""
        event.text = " ".join(event.text.split())


class RawForm(Vertical):
    """A form for bytes in hex; while the user types, it shows what the bytes mean."""

    def compose(self) -> ComposeResult:
        with Horizontal(classes="row"):
            yield Caption("tester.bytes")
            yield BytesField(placeholder=_EXAMPLE, classes="value")
        with Horizontal(classes="row"):
            yield TickBox(label("tester.raw.length"), True)
            yield FormButton("tester.send", "primary", classes="execute")
        yield ResultView()

    def fill_bytes(self, raw: bytes) -> None:
        self.query_one(Input).value = raw.hex(" ").upper()

    @property
    def typed_bytes(self) -> bytes | str:
        """The bytes in the field, or a text that says what is wrong with the field."""
        text = self.query_one(Input).value
        try:
            raw = bytes.fromhex(text)
        except ValueError:
            return label("tester.raw.hex")
        if not 0 < len(raw) <= MAX_DATAGRAM:
            return label("tester.raw.size", most=MAX_DATAGRAM)
        right = self.query_one(TickBox).value and len(raw) >= 16
        return raw[:1] + len(raw).to_bytes(4, "little") + raw[5:] if right else raw

    @on(Input.Changed)
    @on(TickBox.Changed)
    def _check_bytes(self) -> None:
        raw = self.typed_bytes
        problem, items = (raw, ()) if isinstance(raw, str) else ("", parse_datagram(raw))
        self.query_one(ResultView).show_check(problem, "; ".join(map(_frame_text, items)))

    @on(Button.Pressed)
    @on(Input.Submitted)
    def _request_send(self) -> None:
        raw, result = self.typed_bytes, self.query_one(ResultView)
        if isinstance(raw, str):
            result.show_problem(raw)
        else:
            self.post_message(RawWanted(result, raw))


def _frame_text(item: object) -> str:
    if isinstance(item, Frame):
        head = label("tester.raw.frame", name=function_name(item.code), serial=item.serial, count=item.argc)
        return ": ".join(filter(None, (head, _problem_text(item.problems))))
    return _problem_text(getattr(item, "problems", ()))


def _problem_text(problems: Iterable[Problem]) -> str:
    return ", ".join(reader_words().text(problem.reason) for problem in problems)
