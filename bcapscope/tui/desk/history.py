"""The history of calls: a line each, and which of them are wanted."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

from bcapscope.protocol.commands import call_name
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.render.answer import AnswerRenderer
from bcapscope.render.escape import printable
from bcapscope.render.moment import utc_text
from bcapscope.render.notation import bare_text
from bcapscope.render.palette import Palette
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import compile_filter
from bcapscope.traffic.getters import CALL_GETTERS
from bcapscope.traffic.question import COMMAND_FUNCTIONS
from bcapscope.traffic.tracker import Tracker
from bcapscope.tui.desk.record import Record, Who, why
from bcapscope.tui.desk.saved import takes_handle
from bcapscope.tui.words import told

_PLAIN = re.compile(r"[\w\s.@:-]*")
"""Text without anything that an expression of the filter language cannot do without."""

_LONGEST, _LONGEST_NAME = 18, 24

_PLAIN_SUBJECTS = (ObjectClass.CONTROLLER, ObjectClass.ROBOT)
"""Of these one is as a rule in use at a time; their names would push the results out of sight."""

Chooser: TypeAlias = Callable[[Record], bool]
"""Tells whether a call is wanted."""

_MARKS = {Who.USER: " ", Who.SCREEN: "·", Who.WATCH: "~"}


def history_line(record: Record, palette: Palette) -> str:
    """Write a call: number, time of day (UTC), who made it but for the user, call, subject, result, time."""
    color = palette
    head = f"{record.number:>5} {utc_text(record.began)[11:23]} {_MARKS[record.who]}"
    name = f"{call_name(record.function_id, record.arguments)}{_of(record)}{_given(record)}"
    if record.reply is not None:
        text = AnswerRenderer(palette, told).line(
            name, record.function_id, record.reply, record.took, record.attempts
        )
    else:
        took = f"{color.dim}{record.took / 1e6:.3f} ms{color.reset}"
        text = f"{color.name}{printable(name)}{color.reset} {color.bad}{why(record)}{color.reset}  {took}"
    return f"{color.dim}{head}{color.reset} {text}"


def _of(record: Record) -> str:
    """Name what a call was made of, where there are many and the arguments do not tell which."""
    subject = record.subject
    if subject is None or subject.kind in _PLAIN_SUBJECTS:
        return ""
    text = subject.label
    return f" {text}" if len(text) <= _LONGEST_NAME else f" {text[: _LONGEST_NAME - 1]}…"


def _given(record: Record) -> str:
    """Write what a call was given besides a handle and the name of a command, cut short where it is long."""
    function = FUNCTIONS.get(record.function_id)
    named = function is not None and takes_handle(function)
    first = named + (record.function_id in COMMAND_FUNCTIONS)
    text = ", ".join(filter(None, map(bare_text, record.arguments[first:])))
    text = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
    return text and f"({text})"


def chooser(text: str) -> Chooser:
    """Return what tells which calls are wanted.

    Args:
        text: words that the line of a call must have, all of them, or an expression of the filter language;
            with nothing the user's own calls are wanted, and not those of the screen.

    Raises:
        FilterError: it is an expression that makes no sense.
    """
    words = text.casefold().split()
    if not words:
        return lambda record: record.who is Who.USER
    if _PLAIN.fullmatch(text):
        return lambda record: _has(record, words)
    test = compile_filter(text, RecordKind.CALL).bind(CALL_GETTERS)
    return lambda record: (call := exchange_of(record)) is not None and test(call)


def exchange_of(record: Record) -> Exchange | None:
    """Return a call as those of captures are; None where no sound request was sent."""
    tracker = Tracker()
    settled = [each for seen in record.packets for each in tracker.observe(seen)]
    settled += tracker.close()
    return next((each for each in settled if isinstance(each, Exchange)), None)


_PALE = Palette()


def _has(record: Record, words: list[str]) -> bool:
    line = history_line(record, _PALE).casefold()
    return all(word in line for word in words)
