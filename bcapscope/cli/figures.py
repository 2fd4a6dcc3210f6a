"""What commands have in common that tell figures of calls, for the whole time or slice by slice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps

import click

from bcapscope.cli import options
from bcapscope.cli.output import palette
from bcapscope.cli.reading import Reading
from bcapscope.render.palette import Palette
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked for.

    Attributes:
        reading: of the captures.
        as_json: JSON is wanted, not text.
        window: length of a slice of time in nanoseconds; None for the whole.
        wanted: chooses calls; None for all.
        palette: colours of text.
    """

    reading: Reading
    as_json: bool
    window: int | None
    wanted: Filter | None
    palette: Palette


def figures(json_help: str) -> Callable[[Callable[[Asked], None]], Callable[..., None]]:
    """Give a command the arguments and options of such commands.

    Args:
        json_help: what ``--json`` gives.
    """

    def decorate(run: Callable[[Asked], None]) -> Callable[..., None]:
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
            run(Asked(Reading(paths, ports), as_json, window, wanted, palette(color)))

        return command

    return decorate
