"""Options of commands that print chosen fields as columns, and the values of fields that depend on the
captures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

import click

from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.data_output import line_width
from bcapscope.cli.common.options import Decorator
from bcapscope.errors import InputError
from bcapscope.render.color_palette import Palette
from bcapscope.render.record_columns import ColumnRenderer, RecordColumn, parse_columns
from bcapscope.traffic.call import FrameObservation
from bcapscope.traffic.filter.field_table import SINCE_FIRST, RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS
from bcapscope.traffic.observation import Observation

R = TypeVar("R")


def columns_option(kind: RecordKind) -> Decorator:
    """Return the option ``--columns`` for records of `kind`. The option's value is a tuple of columns, or
    None.
    """

    def parse(
        context: click.Context, parameter: click.Parameter, value: str | None
    ) -> tuple[RecordColumn, ...] | None:
        try:
            return None if value is None else parse_columns(value, kind)
        except InputError as error:
            raise click.BadParameter(str(error), context, parameter) from None

    return click.option(
        "--columns",
        metavar="NAME,NAME...",
        callback=parse,
        help="Show only these fields, such as t,command,arg[1]; also with --json and --csv. "
        "`bcapscope fields` lists the names. The names file and file_packet are valid, too.",
    )


wide_option = click.option(
    "--wide",
    is_flag=True,
    help="On a terminal, print long lines in full: do not fold them, or with --columns, do not cut them.",
)


def frame_columns(
    reader: CaptureReader, columns: tuple[RecordColumn, ...], palette: Palette, wide: bool
) -> ColumnRenderer:
    """Return a renderer that prints chosen columns of the `AnnotatedFrame` objects that `reader` reads."""
    getters = _with_reader(FRAME_GETTERS, reader, lambda frame: frame.observation)
    return ColumnRenderer(columns, getters, palette, line_width(wide))


def call_columns(
    reader: CaptureReader, columns: tuple[RecordColumn, ...], palette: Palette, wide: bool
) -> ColumnRenderer:
    """Return a renderer that prints chosen columns of the calls that `reader` reads."""
    getters = _with_reader(CALL_GETTERS, reader, lambda call: call.request)
    return ColumnRenderer(columns, getters, palette, line_width(wide))


def _with_reader(
    getters: Mapping[str, Callable[[R], object]],
    reader: CaptureReader,
    first_frame: Callable[[R], FrameObservation | Observation],
) -> dict[str, Callable[[R], object]]:
    """Return `getters` together with the functions that return the fields `t`, `file` and `file_packet`.

    The values of `t`, `file` and `file_packet` depend on the captures that `reader` reads. `first_frame` is a
    function that returns the first frame of a record.
    """

    def origin(attribute: str) -> Callable[[R], object]:
        return lambda record: getattr(reader.origin_of(first_frame(record).packet), attribute, None)

    return {
        **getters,
        SINCE_FIRST: lambda record: first_frame(record).time - reader.first_time,
        "file": origin("path"),
        "file_packet": origin("packet"),
    }
