"""Arguments of the commands that print figures about calls, for the whole time or by window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.live.standard_streams import choose_palette
from bcapscope.messages import MessageFormatter
from bcapscope.render.color_palette import Palette
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind


@dataclass(frozen=True, slots=True)
class FigureArguments:
    """The arguments of such a command. A window is in ns; None for the whole time."""

    reader: CaptureReader
    as_json: bool
    window: int | None
    call_filter: Filter | None
    palette: Palette
    words: MessageFormatter


def figure_command(json_help: str) -> Callable[[Callable[[FigureArguments], None]], Callable[..., None]]:
    """Return a decorator that adds the arguments and options, and passes them as `FigureArguments`."""

    def decorate(run: Callable[[FigureArguments], None]) -> Callable[..., None]:
        @options.captures
        @options.ports
        @click.option("--json", "as_json", is_flag=True, help=json_help)
        @options.window
        @options.filter_option(RecordKind.CALL)
        @options.color
        @options.language
        @wraps(run)
        def command(
            *,
            paths: tuple[str, ...],
            ports: tuple[int, ...],
            as_json: bool,
            window: int | None,
            wanted: Filter | None,
            color: str,
            words: MessageFormatter,
        ) -> None:
            palette = choose_palette(color)
            reader = CaptureReader(paths, ports, words=words)
            run(FigureArguments(reader, as_json, window, wanted, palette, words))

        return command

    return decorate
