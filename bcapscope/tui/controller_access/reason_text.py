"""Reasons of failures, as text in the reader's language."""

from __future__ import annotations

from bcapscope.errors import BcapError
from bcapscope.live.controller.history_record import HistoryRecord, Reason, error_reason, failure_reason
from bcapscope.tui.reader_language import reader_words


def reason_text(reason: Reason) -> str:
    """Return the reason of a failure in one line; for a time-out, it includes the number of attempts."""
    texts = (part if isinstance(part, str) else reader_words().text(part) for part in reason)
    return ", ".join(filter(None, texts)).partition("\n")[0]


def error_text(error: BcapError | OSError) -> str:
    return reason_text(error_reason(error))


def failure_text(record: HistoryRecord) -> str:
    return reason_text(failure_reason(record))
