"""Frames as a table: comma-separated values (RFC 4180), a row each."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from functools import lru_cache

from bcapscope.protocol.arguments import Problem
from bcapscope.protocol.frame import Malformed
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import hresult_name
from bcapscope.protocol.wording import is_computed
from bcapscope.render.escape import printable
from bcapscope.render.moment import epoch_text
from bcapscope.render.record import RecordRenderer
from bcapscope.traffic.observation import Direction, Flow, Observation
from bcapscope.traffic.question import Question

COLUMNS = (
    "frame",
    "time",
    "src",
    "dst",
    "transport",
    "kind",
    "length",
    "serial",
    "reserved",
    "function_id",
    "function",
    "command",
    "hresult",
    "hresult_name",
    "args",
    "problems",
    "raw",
)
"""Names as in the JSON; `args` is the very text that stands there, `raw` is empty without problems."""

_ARGS, _PROBLEMS = b'"args":', b',"problems":'


def cell(text: str) -> str:
    """Make a text from the wire harmless in a spreadsheet.

    Control characters are escaped, and an apostrophe is put before what a spreadsheet would compute.
    """
    shown = printable(text)
    return f"'{shown}" if is_computed(text) else shown


class _Line:
    """Takes what a csv writer writes and hands it back."""

    def write(self, text: str) -> str:
        return text


class TableRenderer:
    """Writes frames as rows, each without its line end, which RFC 4180 wants to be CR LF."""

    def __init__(self) -> None:
        self._writer = csv.writer(_Line(), lineterminator="")
        self._records = RecordRenderer()

    def header(self) -> str:
        """Write the names of the columns."""
        return self._row(COLUMNS)

    def row(self, seen: Observation, question: Question | None) -> str:
        """Write one row.

        Args:
            seen: the frame or malformed bytes.
            question: what a request asks, or a reply answers where that was seen.
        """
        flow, item = seen.flow, seen.item
        head = (seen.number, epoch_text(seen.time), *_ends(flow))
        if isinstance(item, Malformed):
            nothing = ("",) * 8
            return self._row((*head, "malformed", len(item.raw), *nothing, *_faults(item.problems, item.raw)))
        about = _about(question)
        result = (item.code, hresult_name(item.code)) if flow.direction is Direction.RESPONSE else ("", "")
        frame = (flow.direction.value, item.length, item.serial, item.reserved)
        return self._row(
            (*head, *frame, *about, *result, self._args(seen, question), *_faults(item.problems, item.raw))
        )

    def _args(self, seen: Observation, question: Question | None) -> str:
        """Cut the arguments out of the JSON object, so that there is one place that writes them.

        Inside a JSON string a quotation mark has a backslash before it, so no text can be taken for a key;
        and what begins with a bracket no spreadsheet computes.
        """
        record = self._records.record(seen, question)
        start = record.index(_ARGS) + len(_ARGS)
        return record[start : record.index(_PROBLEMS, start)].decode()

    def _row(self, cells: Iterable[object]) -> str:
        # A csv writer returns what the write method of its file returned.
        return str(self._writer.writerow(cells))


@lru_cache(maxsize=1024)
def _ends(flow: Flow) -> tuple[str, str, str]:
    return cell(flow.src_text), cell(flow.dst_text), flow.conversation.transport.value


def _about(question: Question | None) -> tuple[object, str, str]:
    if question is None:
        return "", "", ""
    return question.function_id, function_name(question.function_id), cell(question.command or "")


def _faults(problems: tuple[Problem, ...], raw: bytes) -> tuple[str, str]:
    if not problems:
        return "", ""
    reasons = "; ".join(f"{problem.code} at {problem.offset}: {problem.reason}" for problem in problems)
    return cell(reasons), raw.hex()
