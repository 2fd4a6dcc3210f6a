"""Arguments of commands that print figures about calls, for the whole capture or per time window."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from typing import Any, NoReturn, TypeVar

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.live.standard_streams import choose_palette
from bcapscope.messages import MessageFormatter
from bcapscope.render.color_palette import Palette
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind

T = TypeVar("T")


class FigureArguments:
    """The arguments of a command such as `stats`. `window` is in ns; None means the whole capture."""

    def __init__(
        self,
        *,
        as_json: bool,
        wanted: Filter | None,
        color: str,
        words: MessageFormatter,
        window: int | None,
        as_csv: bool = False,
        **source: Any,
    ) -> None:
        if as_json and as_csv:
            raise click.UsageError("--json and --csv exclude each other")
        self.reader = CaptureReader(words=words, **source)
        self.as_json = as_json
        self.as_csv = as_csv
        self.call_filter = wanted
        self.window = window
        self._palette = choose_palette(color)

    def print_all(
        self,
        found: Iterable[T],
        record: Callable[[T], bytes],
        lines: Callable[[T, Palette, MessageFormatter], Iterable[str]],
    ) -> NoReturn:
        words = self.reader.citing_words()
        if self.as_json:
            self.reader.print_lines(map(record, found))
        else:
            texts = (chain(lines(each, self._palette, words), ("",)) for each in found)
            self.reader.print_lines(chain.from_iterable(texts))
        self.reader.finish()


def figure_options(json_help: str, has_csv: bool = False) -> options.Decorator:
    as_json = click.option("--json", "as_json", is_flag=True, help=json_help)
    as_csv = click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table with a header.")
    source = (options.captures, options.ports, options.side, options.taken_at)
    formats = (as_json, as_csv) if has_csv else (as_json,)
    selection = (options.filter_option(RecordKind.CALL), options.color, options.language)
    return options.added((*source, *formats, options.window, *selection))
