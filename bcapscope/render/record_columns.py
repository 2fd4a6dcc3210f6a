"""Chosen fields of frames and calls, as columns of text, as CSV and as JSON."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from itertools import chain
from typing import Any, NamedTuple

import orjson

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.frame_template import iter_numbers
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import fit_line
from bcapscope.render.csv_table import csv_cell, csv_row
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import LineTemplateBuilder
from bcapscope.render.json_values import json_ready, text_fragment, time_fragment
from bcapscope.render.timestamp import epoch_text, utc_text
from bcapscope.traffic.filter.field_table import FIELD_BY_NAME, FieldType, FilterField, RecordKind, fields_of
from bcapscope.traffic.filter.matching import element, plain_value
from bcapscope.traffic.filter.tokens import with_nearest
from bcapscope.traffic.observation import Endpoint

_COLUMN = re.compile(r"(\w+)((?:\[[0-9]{1,9}\])*)", re.ASCII)
_NANOSECONDS = {"s": 1e9, "ms": 1e6}
_RIGHT_ALIGNED = frozenset({FieldType.NUMBER, FieldType.DURATION, FieldType.HRESULT})
_WIDTHS = {
    FieldType.TIME: 30,
    FieldType.ENDPOINT: 21,
    FieldType.DURATION: 12,
    FieldType.NUMBER: 6,
    FieldType.HRESULT: 10,
    FieldType.TEXT: 10,
}
"""Minimum widths of columns. A longer cell widens the column in this line and in all following lines."""

ORIGIN_FIELDS = (
    FilterField("file", FieldType.TEXT, tuple(RecordKind), "capture that contains the packet"),
    FilterField("file_packet", FieldType.NUMBER, tuple(RecordKind), "number of the packet in its capture"),
)

CALL_COLUMNS = (
    *("call", "started", "t", "client", "server", "transport", "function_id", "function", "command"),
    *("hresult", "hresult_name", "latency_ms", "rtt_ms", "outcome", "verdict", "convention", "retries"),
    *("executing", "serials", "requests", "replies", "late_replies", "lost_replies", "duplicates"),
)
"""Columns of `calls --csv` if the user selects none."""


class ColumnFormat(StrEnum):
    """Format of the output: CSV or JSON. A parameter `format_` is None if the output is lines of text."""

    CSV = "csv"
    JSON = "json"


class RecordColumn(NamedTuple):
    """A field that the user selected, with the indexes that follow its name."""

    name: str
    field: FilterField
    path: tuple[int, ...]
    type: FieldType


def parse_columns(text: str, kind: RecordKind) -> tuple[RecordColumn, ...]:
    """Parse the names of fields, separated by commas; a name can have indexes, as in `arg[1][0]`.

    Raises:
        InputError: A name is unknown, or an index follows the name of a field without elements.
    """
    return tuple(_parse_column(each.strip(), kind) for each in text.split(","))


def _parse_column(text: str, kind: RecordKind) -> RecordColumn:
    known = fields_of(kind) | {field.name: field for field in ORIGIN_FIELDS}
    match = _COLUMN.fullmatch(text)
    if match is not None and match[1] not in known and match[1] in FIELD_BY_NAME:
        raise InputError(Message(f"filter.not-of-{kind}s", name=match[1]))
    if match is None or match[1] not in known:
        unknown = Message("input.no-such-field", name=f"{text!r}")
        raise InputError(with_nearest(unknown, text, known))
    field, path = known[match[1]], tuple(map(int, re.findall("[0-9]+", match[2])))
    type_ = field.type
    for _ in path:
        if type_.element is None:
            raise InputError(Message("filter.no-list", name=field.name))
        type_ = type_.element
    return RecordColumn(text, field, path, type_)


class ColumnRenderer:
    def __init__(
        self,
        columns: Sequence[RecordColumn],
        getters: Mapping[str, Callable[[Any], object]],
        palette: Palette = PLAIN,
        width: int | None = None,
    ) -> None:
        """`getters` maps names to functions that read a record. Lines are cut to `width` columns."""
        self._width = width
        self._columns = columns
        self._readers = [(each, getters[each.field.getter_name]) for each in columns]
        self._palette = palette
        self._widths = [max(display_width(each.name), _WIDTHS.get(each.type, 0)) for each in columns]

    def lines(
        self, records: Iterable[object], format_: ColumnFormat | None
    ) -> Iterator[str] | Iterator[bytes]:
        """Return one line per record. Text and CSV begin with a header line. In JSON, each line is an object,
        and there is no header line.
        """
        if format_ is ColumnFormat.JSON:
            return map(self._json_object, records)
        names = [each.name for each in self._columns]
        if format_ is ColumnFormat.CSV:
            return chain([csv_row(names)], map(self._csv_row, records))
        header = f"{self._palette.dim}{self._aligned(names)}{self._palette.reset}"
        return chain([header], map(self._line, records))

    def _line(self, record: object) -> str:
        return self._aligned([text_cell(column, value) for column, value in self._values(record)])

    def _json_object(self, record: object) -> bytes:
        return orjson.dumps({each.name: _json_value(each, value) for each, value in self._values(record)})

    def _csv_row(self, record: object) -> str:
        return csv_row([_csv_cell(column, value) for column, value in self._values(record)])

    def _values(self, record: object) -> Iterator[tuple[RecordColumn, object]]:
        for column, read in self._readers:
            value = read(record)
            for index in column.path:
                value = element(value, index)
            yield column, value

    def _aligned(self, cells: Sequence[str]) -> str:
        texts = []
        for index, (cell, column) in enumerate(zip(cells, self._columns, strict=True)):
            width = display_width(cell)
            self._widths[index] = max(self._widths[index], width)
            space = " " * (self._widths[index] - width)
            texts.append(space + cell if column.type in _RIGHT_ALIGNED else cell + space)
        line = "  ".join(texts).rstrip()
        return line if self._width is None else fit_line(line, self._width)


def text_cell(column: RecordColumn, value: object) -> str:
    """Return a value as escaped text in the notation of filters; `-` if the value is missing."""
    if value is None:
        return "-"
    if column.type is FieldType.TIME and isinstance(value, int):
        return utc_text(value)
    if column.type is FieldType.HRESULT and isinstance(value, int):
        return f"0x{value & 0xFFFFFFFF:08X}"
    return printable(_plain_text(column, value)) or "-"


def _csv_cell(column: RecordColumn, value: object) -> object:
    if value is None:
        return ""
    if column.type is FieldType.TIME and isinstance(value, int):
        return epoch_text(value)
    text = _plain_text(column, value)
    # `csv_cell` would escape -1 like a formula, although a spreadsheet reads -1 as a number
    return text if isinstance(value, (int, float)) else csv_cell(text)


def _plain_text(column: RecordColumn, value: object) -> str:
    if column.type is FieldType.DURATION and isinstance(value, int):
        unit = column.field.unit
        return f"{value / _NANOSECONDS[unit or 'ms']:.{6 if unit == 's' else 3}f}{'' if unit else 'ms'}"
    if isinstance(value, (list, tuple)) and not isinstance(value, Endpoint):
        return " ".join(map(_value_text, value))
    return _value_text(value)


def _value_text(value: object) -> str:
    if isinstance(value, Argument):
        value = value.variant
    if isinstance(value, Variant):
        builder = LineTemplateBuilder()
        builder.add_variant(value, typed=False)
        return builder.build().fill((), tuple(iter_numbers(value)))
    if isinstance(value, bytes):
        return value.hex()
    return str(value).lower() if isinstance(value, bool) else str(value)


def _json_value(column: RecordColumn, value: object) -> object:
    if isinstance(value, int) and column.type is FieldType.TIME:
        return time_fragment(value)
    if isinstance(value, int) and column.type is FieldType.DURATION and column.field.unit:
        return value / _NANOSECONDS[column.field.unit]
    if column.type is FieldType.DURATION and value is not None:
        return _plain_text(column, value)
    return _json_item(value)


def _json_item(value: object) -> object:
    value = plain_value(value)
    if isinstance(value, Endpoint):
        return text_fragment(str(value))
    if isinstance(value, (list, tuple)):
        return [_json_item(each) for each in value]
    if isinstance(value, bytes):
        return list(value)
    if value is None or isinstance(value, (bool, int, float)):
        return json_ready(value)
    return text_fragment(str(value))
