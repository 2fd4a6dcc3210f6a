"""Frames as comma-separated values (RFC 4180), one row per frame."""

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
"""`args` holds the JSON text of the arguments. `raw` is empty for frames without problems."""

_ARGS, _PROBLEMS = b'"args":', b',"problems":'


def csv_cell(text: str) -> str:
    """Escape text from the wire. Begin with an apostrophe if a spreadsheet would evaluate the text."""
    shown = printable(text)
    return f"'{shown}" if is_spreadsheet_formula(text) else shown


class _ReturningFile:
    def write(self, text: str) -> str:
        return text


_writer = csv.writer(_ReturningFile(), lineterminator="")


def csv_row(cells: Iterable[object]) -> str:
    """Return a row without a line end. A cell with text from the wire must be a result of `csv_cell`."""
    # `csv.writer.writerow` returns the result of its file's `write` method.
    return str(_writer.writerow(cells))


class CsvTableRenderer:
    """Writes rows without line ends. The caller adds CR LF, as RFC 4180 requires."""

    def __init__(self) -> None:
        self._records = FrameRecordRenderer()

    def header(self) -> str:
        return csv_row(COLUMNS)

    def row(self, observation: Observation, call_kind: CallKind | None) -> str:
        flow, item = observation.flow, observation.item
        head = (observation.number, epoch_text(observation.time), *_endpoint_cells(flow))
        if isinstance(item, Malformed):
            nothing = ("",) * 8
            return csv_row(
                (*head, "malformed", len(item.raw), *nothing, *_problem_cells(item.problems, item.raw))
            )
        about = _call_kind_cells(call_kind)
        result = (item.code, hresult_name(item.code)) if flow.direction is Direction.RESPONSE else ("", "")
        frame = (flow.direction.value, item.length, item.serial, item.reserved)
        return csv_row(
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
        """Return the arguments as JSON, copied from the JSON object of the frame.

        The first ``"args":`` in the JSON is the name of the member `args`. These characters cannot be part of
        a string value before it, because JSON escapes quotation marks inside strings. The result begins with
        a bracket, so a spreadsheet does not evaluate the result as a formula.
        """
        record = self._records.record(observation, call_kind)
        start = record.index(_ARGS) + len(_ARGS)
        return record[start : record.index(_PROBLEMS, start)].decode()


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
