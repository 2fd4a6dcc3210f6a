"""Frames and calls as tables of pandas and Arrow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from bcapscope.errors import MissingExtraError
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_template import iter_numbers
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS, AnnotatedFrame

if TYPE_CHECKING:
    import pandas
    import pyarrow

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

_ROWS_AT_ONCE = 65_536


class ColumnType(Enum):
    """Type of a column, with its name in pandas. All but `INTEGER` columns can have missing values."""

    INTEGER = "int64"
    OPTIONAL_INTEGER = "Int64"
    FLOAT = "float64"
    TEXT = "string"
    TIME = "datetime64[ns]"  # ns since 1970, UTC
    NUMBERS = "object"  # lists of floats


class DataColumn(NamedTuple, Generic[T]):
    name: str
    type: ColumnType
    read: Callable[[T], object]


class Records(Generic[T_co]):
    """Records of a capture. Each iteration reads the capture again, and keeps only a small part of it in
    memory.
    """

    def __init__(self, read: Callable[[], Iterator[T_co]]) -> None:
        self._read = read

    def __iter__(self) -> Iterator[T_co]:
        """Start to read.

        Raises:
            CaptureError: A capture cannot be read to its end. Before this error, the iterator yields all
                records that it can read.
        """
        return self._read()


class TableRecords(Records[T]):
    """Records that can be converted to a table. docs/python.md describes the columns."""

    def __init__(self, read: Callable[[], Iterator[T]], columns: Sequence[DataColumn[T]]) -> None:
        super().__init__(read)
        self._columns = columns

    def to_pandas(self) -> pandas.DataFrame:
        """Read all records into a DataFrame.

        Raises:
            MissingExtraError: pandas is not installed.
            CaptureError: A capture cannot be read to its end.
        """
        try:
            import pandas  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            raise MissingExtraError("pandas", "pandas") from error
        parts = [
            pandas.DataFrame(
                {
                    column.name: _pandas_series(pandas, column.type, values)
                    for column, values in zip(self._columns, part, strict=True)
                }
            )
            for part in self._parts()
        ]
        return pandas.concat(parts, ignore_index=True) if len(parts) > 1 else parts[0]

    def to_arrow(self) -> pyarrow.Table:
        """Read all records into a table of Arrow.

        Raises:
            MissingExtraError: pyarrow is not installed.
            CaptureError: A capture cannot be read to its end.
        """
        try:
            import pyarrow  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            raise MissingExtraError("pyarrow", "arrow") from error
        types = _arrow_types(pyarrow)
        schema = pyarrow.schema(
            [
                pyarrow.field(column.name, types[column.type], nullable=column.type is not ColumnType.INTEGER)
                for column in self._columns
            ]
        )
        batches = [
            pyarrow.record_batch(
                [pyarrow.array(values, field.type) for values, field in zip(part, schema, strict=True)],
                schema=schema,
            )
            for part in self._parts()
        ]
        return pyarrow.Table.from_batches(batches, schema)

    def _parts(self) -> Iterator[list[list[object]]]:
        """Yield the table in parts of `_ROWS_AT_ONCE` rows. An empty table is one part with empty columns."""
        records, readers = iter(self), [column.read for column in self._columns]
        part = list(islice(records, _ROWS_AT_ONCE))
        while True:
            yield [[read(record) for record in part] for read in readers]
            part = list(islice(records, _ROWS_AT_ONCE))
            if not part:
                return


def _pandas_series(pandas: Any, type_: ColumnType, values: list[object]) -> Any:
    series = pandas.Series(values, dtype=type_.value)
    return series.dt.tz_localize("UTC") if type_ is ColumnType.TIME else series


def _arrow_types(pyarrow: Any) -> dict[ColumnType, Any]:
    return {
        ColumnType.INTEGER: pyarrow.int64(),
        ColumnType.OPTIONAL_INTEGER: pyarrow.int64(),
        ColumnType.FLOAT: pyarrow.float64(),
        ColumnType.TEXT: pyarrow.string(),
        ColumnType.TIME: pyarrow.timestamp("ns", "UTC"),
        ColumnType.NUMBERS: pyarrow.list_(pyarrow.float64()),
    }


def _numbers(frame: Frame | None) -> list[float] | None:
    """Return the numbers in the last argument of the frame, or None if there are no numbers."""
    variants = () if frame is None else frame.variants
    numbers = (
        [float(each) for each in iter_numbers(variants[-1]) if not isinstance(each, bytes)]
        if variants
        else []
    )
    return numbers or None


def _text(text: str | None) -> str | None:
    """Return text from the wire without lone surrogates, which neither Arrow nor UTF-8 can hold."""
    return None if text is None else text.encode("utf-8", "replace").decode("utf-8")


def _time(time: int) -> int | None:
    """Return `time`, or None if a damaged capture has a time that is too large for pandas and Arrow."""
    return time if abs(time) < 1 << 63 else None


def _milliseconds(duration: int | None) -> float | None:
    return None if duration is None else duration / 1e6


_INTEGER, _OPTIONAL, _TEXT = ColumnType.INTEGER, ColumnType.OPTIONAL_INTEGER, ColumnType.TEXT

FRAME_COLUMNS: tuple[DataColumn[AnnotatedFrame], ...] = (
    DataColumn("frame", _INTEGER, lambda each: each.number),
    DataColumn("time", ColumnType.TIME, lambda each: _time(each.time)),
    DataColumn("packet", _INTEGER, lambda each: each.observation.packet),
    DataColumn("src", _TEXT, lambda each: each.observation.flow.src_text),
    DataColumn("dst", _TEXT, lambda each: each.observation.flow.dst_text),
    DataColumn("transport", _TEXT, lambda each: each.conversation.transport.value),
    DataColumn("kind", _TEXT, lambda each: each.kind),
    DataColumn("bytes", _INTEGER, lambda each: len(each.raw)),
    DataColumn("serial", _OPTIONAL, FRAME_GETTERS["serial"]),
    DataColumn("reserved", _OPTIONAL, FRAME_GETTERS["reserved"]),
    DataColumn("function_id", _OPTIONAL, FRAME_GETTERS["function_id"]),
    DataColumn("function", _TEXT, lambda each: each.function),
    DataColumn("command", _TEXT, lambda each: _text(each.command)),
    DataColumn("hresult", _OPTIONAL, lambda each: each.hresult),
    DataColumn("hresult_name", _TEXT, FRAME_GETTERS["hresult_name"]),
    DataColumn("numbers", ColumnType.NUMBERS, lambda each: _numbers(each.frame)),
    DataColumn("problems", _INTEGER, lambda each: len(each.problems)),
)

CALL_COLUMNS: tuple[DataColumn[Call], ...] = (
    DataColumn("call", _INTEGER, lambda call: call.number),
    DataColumn("started", ColumnType.TIME, lambda call: _time(call.request.time)),
    DataColumn("client", _TEXT, lambda call: str(call.conversation.client)),
    DataColumn("server", _TEXT, lambda call: str(call.conversation.server)),
    DataColumn("transport", _TEXT, lambda call: call.conversation.transport.value),
    DataColumn("function_id", _INTEGER, lambda call: call.kind.function_id),
    DataColumn("function", _TEXT, lambda call: call.function),
    DataColumn("command", _TEXT, lambda call: _text(call.command)),
    DataColumn("hresult", _OPTIONAL, lambda call: call.hresult),
    DataColumn("hresult_name", _TEXT, CALL_GETTERS["hresult_name"]),
    DataColumn("latency_ms", ColumnType.FLOAT, lambda call: _milliseconds(call.latency)),
    DataColumn("rtt_ms", ColumnType.FLOAT, lambda call: _milliseconds(call.rtt)),
    DataColumn("outcome", _TEXT, lambda call: call.outcome.value),
    DataColumn("verdict", _TEXT, lambda call: call.verdict.value),
    DataColumn("retries", _INTEGER, lambda call: call.retries),
    DataColumn("unseen_retries", _INTEGER, lambda call: call.unseen_retries),
    DataColumn("executing", _INTEGER, lambda call: len(call.notices)),
    DataColumn("request_frame", _INTEGER, lambda call: call.request.number),
    DataColumn("reply_frame", _OPTIONAL, lambda call: None if call.reply is None else call.reply.number),
    DataColumn("request_numbers", ColumnType.NUMBERS, lambda call: _numbers(call.request.item)),
    DataColumn(
        "reply_numbers",
        ColumnType.NUMBERS,
        lambda call: None if call.reply is None else _numbers(call.reply.item),
    ),
)
