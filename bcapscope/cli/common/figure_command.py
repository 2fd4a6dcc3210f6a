"""Arguments of commands that print figures about calls, for the whole capture or per time window."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain
from typing import NoReturn, TypeVar

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.live.standard_streams import choose_palette
from bcapscope.messages import MessageFormatter
from bcapscope.render.color_palette import Palette
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.joining.joined_observation import CapturePlace

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class FigureArguments:
    """The arguments of a command that prints figures.

    `window` is the length of a time window in ns; None means the whole capture.
    """

    reader: CaptureReader
    as_json: bool
    call_filter: Filter | None
    palette: Palette
    window: int | None
    as_csv: bool = False

    def print_all(
        self,
        found: Iterable[T],
        record: Callable[[T], bytes],
        lines: Callable[[T, Palette, MessageFormatter], Iterable[str]],
    ) -> NoReturn:
        """Print each object in `found` as JSON, or as text followed by an empty line. Then exit."""
        words = self.reader.citing_words()
        if self.as_json:
            self.reader.print_lines(map(record, found))
        else:
            texts = (chain(lines(each, self.palette, words), ("",)) for each in found)
            self.reader.print_lines(chain.from_iterable(texts))
        self.reader.finish()


def _make_arguments(
    *,
    paths: tuple[str, ...],
    ports: tuple[int, ...],
    taken_at: CapturePoint | None,
    as_json: bool,
    wanted: Filter | None,
    color: str,
    words: MessageFormatter,
    side: CapturePlace | None,
    window: int | None,
    as_csv: bool = False,
) -> FigureArguments:
    if as_json and as_csv:
        raise click.UsageError("--json and --csv exclude each other")
    reader = CaptureReader(paths, ports, words=words, side=side, taken_at=taken_at)
    return FigureArguments(reader, as_json, wanted, choose_palette(color), window, as_csv)


def figure_command(json_help: str, has_csv: bool = False) -> options.Decorator:
    """Return a decorator that adds the options of figure commands to a command. The command gets the values
    of these options as one `FigureArguments`.
    """
    as_json = click.option("--json", "as_json", is_flag=True, help=json_help)
    selection = (options.filter_option(RecordKind.CALL), options.color, options.language)
    as_csv = click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table with a header.")
    formats = (as_json, as_csv) if has_csv else (as_json,)
    source = (options.captures, options.ports, options.side, options.taken_at)
    added = (*source, *formats, options.window, *selection)
    return options.bundled("arguments", _make_arguments, added)
