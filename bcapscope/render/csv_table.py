"""Frames as a table: comma-separated values (RFC 4180), a row each."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from functools import lru_cache

from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Malformed
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.protocol.text_format import is_spreadsheet_formula
from bcapscope.render.escape import printable
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.timestamp import epoch_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Flow, Observation

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


def csv_cell(text: str) -> str:
    """Make a text from the wire harmless in a spreadsheet.

    Control characters are escaped, and an apostrophe is put before what a spreadsheet would compute.
    """
    shown = printable(text)
    return f"'{shown}" if is_spreadsheet_formula(text) else shown


class _ReturningFile:
    """Takes what a csv writer writes and hands it back."""

    def write(self, text: str) -> str:
        return text


class CsvTableRenderer:
    """Writes frames as rows, each without its line end, which RFC 4180 wants to be CR LF."""

    def __init__(self) -> None:
        self._writer = csv.writer(_ReturningFile(), lineterminator="")
        self._records = FrameRecordRenderer()

    def header(self) -> str:
        """Write the names of the columns."""
        return self._row(COLUMNS)

    def row(self, observation: Observation, call_kind: CallKind | None) -> str:
        """Write the row of a frame or of malformed bytes."""
        flow, item = observation.flow, observation.item
        head = (observation.number, epoch_text(observation.time), *_endpoint_cells(flow))
        if isinstance(item, Malformed):
            nothing = ("",) * 8
            return self._row(
                (*head, "malformed", len(item.raw), *nothing, *_problem_cells(item.problems, item.raw))
            )
        about = _call_kind_cells(call_kind)
        result = (item.code, hresult_name(item.code)) if flow.direction is Direction.RESPONSE else ("", "")
        frame = (flow.direction.value, item.length, item.serial, item.reserved)
        return self._row(
            (
                *head,
                *frame,
                *about,
                *result,
                self._args(observation, call_kind),
                *_problem_cells(item.problems, item.raw),
            )
        )

    def _args(self, observation: Observation, call_kind: CallKind | None) -> str:
        """Cut the arguments out of the JSON object, so that there is one place that writes them.

        Inside a JSON string a quotation mark has a backslash before it, so no text can be taken for a key;
        and what begins with a bracket no spreadsheet computes.
        """
        record = self._records.record(observation, call_kind)
        start = record.index(_ARGS) + len(_ARGS)
        return record[start : record.index(_PROBLEMS, start)].decode()

    def _row(self, cells: Iterable[object]) -> str:
        # A csv writer returns what the write method of its file returned.
        return str(self._writer.writerow(cells))


@lru_cache(maxsize=1024)
def _endpoint_cells(flow: Flow) -> tuple[str, str, str]:
    return csv_cell(flow.src_text), csv_cell(flow.dst_text), flow.conversation.transport.value


def _call_kind_cells(call_kind: CallKind | None) -> tuple[object, str, str]:
    if call_kind is None:
        return "", "", ""
    return call_kind.function_id, function_name(call_kind.function_id), csv_cell(call_kind.command or "")


def _problem_cells(problems: tuple[Problem, ...], raw: bytes) -> tuple[str, str]:
    if not problems:
        return "", ""
    reasons = "; ".join(f"{problem.code} at {problem.offset}: {problem.reason}" for problem in problems)
    return csv_cell(reasons), raw.hex()
