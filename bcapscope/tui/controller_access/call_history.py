"""The history of calls, shown one per line, selected with a filter, and copied to the clipboard as text."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.errors import BcapError
from bcapscope.live.controller.history_record import (
    HistoryRecord,
    Initiator,
    Reason,
    error_reason,
    failure_reason,
)
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS, call_name
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.render.call_code import hex_text, python_program, shell_command
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.reply_text import reply_line
from bcapscope.render.timestamp import utc_text
from bcapscope.render.value_text import untyped_text
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.pipeline import CallCollector, Pipeline
from bcapscope.tui.reader_language import reader_words

_PLAIN_WORDS = re.compile(r"[\w\s.@:-]*")  # any other text, such as one with "=", is a filter expression

_MAX_ARGUMENT_TEXT, _MAX_SUBJECT_TEXT = 18, 24

_UNNAMED_SUBJECTS = (ObjectClass.CONTROLLER, ObjectClass.ROBOT)
"""Classes of objects that a line omits, because usually a client uses only one controller and one robot."""

RecordFilter: TypeAlias = Callable[[HistoryRecord], bool]

_INITIATOR_MARKS = {Initiator.USER: " ", Initiator.SCREEN: "·", Initiator.WATCH: "~"}


def history_line(record: HistoryRecord, palette: Palette) -> str:
    """Return number, time (UTC), mark of the initiator, function or command, object, result and duration."""
    head = f"{record.number:>5} {utc_text(record.began)[11:23]} {_INITIATOR_MARKS[record.initiator]}"
    name = f"{call_name(record.function_id, record.arguments)}{_subject_text(record)}{_argument_text(record)}"
    if record.reply is not None:
        given = name, record.function_id, record.reply, record.took, record.attempts
        text = reply_line(*given, palette=palette, words=reader_words())
    else:
        took = f"{palette.dim}{record.took / 1e6:.3f} ms{palette.reset}"
        failure = f"{palette.bad}{failure_text(record)}{palette.reset}"
        text = f"{palette.name}{printable(name)}{palette.reset} {failure}  {took}"
    return f"{palette.dim}{head}{palette.reset} {text}"


def _subject_text(record: HistoryRecord) -> str:
    subject = record.subject
    if subject is None or subject.kind in _UNNAMED_SUBJECTS:
        return ""
    text = subject.label
    return f" {text}" if len(text) <= _MAX_SUBJECT_TEXT else f" {text[: _MAX_SUBJECT_TEXT - 1]}…"


def _argument_text(record: HistoryRecord) -> str:
    function = FUNCTIONS.get(record.function_id)
    named = function is not None and function.takes_handle
    first = named + (record.function_id in COMMAND_FUNCTIONS)
    text = ", ".join(filter(None, map(untyped_text, record.arguments[first:])))
    text = text if len(text) <= _MAX_ARGUMENT_TEXT else f"{text[: _MAX_ARGUMENT_TEXT - 1]}…"
    return text and f"({text})"


def history_filter(text: str) -> RecordFilter:
    """Return a filter for words that the line of a call must contain, or for a filter expression. An empty
    text selects the calls that the user made. Raises `FilterError` for an invalid expression.
    """
    words = text.casefold().split()
    if not words:
        return lambda record: record.initiator is Initiator.USER
    if _PLAIN_WORDS.fullmatch(text):
        return lambda record: _has_words(record, words)
    test = compile_filter(text, RecordKind.CALL).bind(CALL_GETTERS)
    return lambda record: (call := call_of_record(record)) is not None and test(call)


def call_of_record(record: HistoryRecord) -> Call | None:
    """Convert to a `Call`, as if it had been captured; return None if no intact request was sent."""
    calls = CallCollector()
    pipeline = Pipeline(calls)
    for observation in record.packets:
        pipeline.add(observation)
    pipeline.finish()
    return next(iter(calls.calls), None)


def _has_words(record: HistoryRecord, words: list[str]) -> bool:
    line = history_line(record, PLAIN).casefold()
    return all(word in line for word in words)


def copy_text(record: HistoryRecord, copy_format: str, target: ControllerTarget) -> str | None:
    """Return a call in the format ``hex``, ``python`` or ``line``; None if the format cannot express it."""
    if copy_format == "hex":
        return "\n".join(hex_text(seen.item.raw) for seen in record.packets) or None
    write = python_program if copy_format == "python" else shell_command
    return write(target, record.function_id, record.arguments, record.subject)


def reason_text(reason: Reason) -> str:
    texts = (part if isinstance(part, str) else reader_words().text(part) for part in reason)
    return ", ".join(filter(None, texts)).partition("\n")[0]


def error_text(error: BcapError | OSError) -> str:
    return reason_text(error_reason(error))


def failure_text(record: HistoryRecord) -> str:
    return reason_text(failure_reason(record))
