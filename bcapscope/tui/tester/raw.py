"""Raw packets: bytes in hex, sent as they are, or with length and serial put right."""

from __future__ import annotations

from collections.abc import Iterable

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.events import Paste
from textual.widgets import Button, Input

from bcapscope.protocol.frame import Frame, Problem, parse_datagram
from bcapscope.protocol.functions import function_name
from bcapscope.tui.tester.field import Caption
from bcapscope.tui.tester.messages import RawWanted
from bcapscope.tui.tester.result import ResultView
from bcapscope.tui.tester.tick import Tick
from bcapscope.tui.words import say, told

LONGEST = 65_507
"""Bytes that one datagram carries at most."""

_EXAMPLE = "01 10 00 00 00 01 00 00 00 02 00 00 00 00 00 04"


class BytesField(Input):
    """A field for bytes, which are copied from places where they stand in several lines."""

    def _on_paste(self, event: Paste) -> None:
        """Take all lines as one."""
        event.prevent_default()
        event.stop()
        super()._on_paste(Paste(" ".join(event.text.split())))


class RawForm(Vertical):
    """A field for bytes in hex; says what they are while they are typed."""

    def compose(self) -> ComposeResult:
        """Put the field above its button."""
        with Horizontal(classes="row"):
            yield Caption("tester.bytes")
            yield BytesField(placeholder=_EXAMPLE, classes="value")
        with Horizontal(classes="row"):
            yield Tick(say("tester.raw.length"), True)
            yield Button(say("tester.send"), compact=True, variant="primary", classes="execute")
        yield ResultView()

    def put(self, raw: bytes) -> None:
        """Show bytes."""
        self.query_one(Input).value = raw.hex(" ").upper()

    @property
    def raw(self) -> bytes | str:
        """The bytes, or what is wrong with what was typed."""
        text = self.query_one(Input).value
        try:
            raw = bytes.fromhex(text)
        except ValueError:
            return say("tester.raw.hex")
        if not 0 < len(raw) <= LONGEST:
            return say("tester.raw.size", most=LONGEST)
        right = self.query_one(Tick).value and len(raw) >= 16
        return raw[:1] + len(raw).to_bytes(4, "little") + raw[5:] if right else raw

    @on(Input.Changed)
    @on(Tick.Changed)
    def _look(self, message: Input.Changed | Tick.Changed) -> None:
        message.stop()
        raw, result = self.raw, self.query_one(ResultView)
        if isinstance(raw, str):
            result.problem(raw)
        else:
            result.hint("; ".join(map(_words, parse_datagram(raw))))

    @on(Button.Pressed)
    @on(Input.Submitted)
    def _send(self, message: Button.Pressed | Input.Submitted) -> None:
        message.stop()
        raw, result = self.raw, self.query_one(ResultView)
        if isinstance(raw, str):
            result.problem(raw)
        else:
            self.post_message(RawWanted(result, raw))


def _words(item: object) -> str:
    """Say what bytes are: a frame of which function, and what is wrong with them."""
    if isinstance(item, Frame):
        head = say("tester.raw.frame", name=function_name(item.code), serial=item.serial, count=item.argc)
        return ": ".join(filter(None, (head, _wrong(item.problems))))
    return _wrong(getattr(item, "problems", ()))


def _wrong(problems: Iterable[Problem]) -> str:
    return ", ".join(told(problem.reason) for problem in problems)
