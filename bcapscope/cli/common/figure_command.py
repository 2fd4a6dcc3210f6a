"""What commands have in common that tell figures of calls, for the whole time or slice by slice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.live.standard_streams import choose_palette
from bcapscope.render.color_palette import Palette
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind


@dataclass(frozen=True, slots=True)
class FigureArguments:
    """What is asked for.

    Attributes:
        reader: of the captures.
        as_json: JSON is wanted, not text.
        window: length of a slice of time in nanoseconds; None for the whole.
        call_filter: chooses calls; None for all.
        palette: colours of text.
    """

    reader: CaptureReader
    as_json: bool
    window: int | None
    call_filter: Filter | None
    palette: Palette


def figure_command(json_help: str) -> Callable[[Callable[[FigureArguments], None]], Callable[..., None]]:
    """Give a command the arguments and options of such commands.

    Args:
        json_help: what ``--json`` gives.
    """

    def decorate(run: Callable[[FigureArguments], None]) -> Callable[..., None]:
        @options.captures
        @options.ports
        @click.option("--json", "as_json", is_flag=True, help=json_help)
        @options.window
        @options.filter_option(RecordKind.CALL)
        @options.color
        @wraps(run)
        def command(
            *,
            paths: tuple[str, ...],
            ports: tuple[int, ...],
            as_json: bool,
            window: int | None,
            wanted: Filter | None,
            color: str,
        ) -> None:
            run(FigureArguments(CaptureReader(paths, ports), as_json, window, wanted, choose_palette(color)))

        return command

    return decorate
