"""Options and renderer of commands that print chosen fields as columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any

import click

from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.data_output import line_width
from bcapscope.cli.common.options import Decorator, parsed_by
from bcapscope.render.color_palette import Palette
from bcapscope.render.record_columns import ColumnRenderer, RecordColumn, parse_columns
from bcapscope.traffic.filter.field_table import SINCE_FIRST, RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS


def columns_option(kind: RecordKind) -> Decorator:
    """Return the option ``--columns``, whose value is a tuple of columns or None."""
    return click.option(
        "--columns",
        metavar="NAME,NAME...",
        callback=parsed_by(lambda text: parse_columns(text, kind)),
        help="Show only these fields, such as t,command,arg[1]; also with --json and --csv. "
        "`bcapscope fields` lists the names. `file` (the capture) and `file_packet` (the number of the "
        "packet in its capture) are valid, too.",
    )


wide_option = click.option(
    "--wide",
    is_flag=True,
    help="On a terminal, do not fold long lines. With --columns, do not cut long lines.",
)


def column_renderer(
    kind: RecordKind, reader: CaptureReader, columns: tuple[RecordColumn, ...], palette: Palette, wide: bool
) -> ColumnRenderer:
    """Return a renderer that shows calls or `AnnotatedFrame` objects in columns."""
    is_frame = kind is RecordKind.FRAME
    getters: Mapping[str, Callable[[Any], object]] = FRAME_GETTERS if is_frame else CALL_GETTERS
    first_frame = attrgetter("observation" if is_frame else "request")

    def origin(attribute: str) -> Callable[[Any], object]:
        return lambda record: getattr(reader.captures.origin_of(first_frame(record).packet), attribute, None)

    # the values of these fields depend on the captures
    of_reader: dict[str, Callable[[Any], object]] = {
        SINCE_FIRST: lambda record: first_frame(record).time - reader.first_time,
        "file": origin("path"),
        "file_packet": origin("packet"),
    }
    return ColumnRenderer(columns, {**getters, **of_reader}, palette, line_width(wide))
