"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from bcapscope.protocol.number_parsing import LONGEST_NUMBER, parse_integer, parse_number
from bcapscope.protocol.text_format import shortened
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.filter.compiler import Filter, FilterError, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind

F = TypeVar("F", bound=Callable[..., Any])

LARGEST_SEED = 2**63 - 1
LARGEST_COUNT = 1_000_000_000
"""Calls, rounds and the like that may be asked for: years of a call each 8 ms are 100 million."""

_LARGEST_NUMBER = 1_000_000.0
"""A quarter of an hour in ms, eleven days in s: more than anybody waits, and clocks can still count it."""


class NumberRange(click.FloatRange):
    """A number within bounds, in ASCII digits."""

    def __init__(self, minimum: float, maximum: float = _LARGEST_NUMBER) -> None:
        super().__init__(min=minimum, max=maximum)
        self.minimum, self.maximum = minimum, maximum

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read a number; an error names the bounds."""
        number = parse_number(str(value), self.minimum, self.maximum)
        if number is None:
            self.fail(
                f"{_quoted_input(value)} is not a number from {self.minimum:.10g} to {self.maximum:.10g}.",
                param,
                ctx,
            )
        return number


class IntegerRange(click.IntRange):
    """An integer within bounds, in ASCII digits."""

    def __init__(self, minimum: int, maximum: int) -> None:
        super().__init__(min=minimum, max=maximum)
        self.minimum, self.maximum = minimum, maximum

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read an integer; an error names the bounds."""
        number = parse_integer(str(value), self.minimum, self.maximum)
        if number is None:
            self.fail(
                f"{_quoted_input(value)} is not an integer from {self.minimum} to {self.maximum}.", param, ctx
            )
        return number


def _quoted_input(value: object) -> str:
    return repr(shortened(str(value), LONGEST_NUMBER))


_PATH = click.Path(allow_dash=True)

paths = click.argument("paths", nargs=-1, metavar="PATH...", type=_PATH)
"""Captures; none where another option says what to read."""

captures = click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=_PATH)
"""Captures, at least one."""

interface = click.option(
    "-i",
    "--interface",
    metavar="NAME",
    help="Capture live on this interface, or on all with `any`, until Ctrl-C; needs the right to capture.",
)

ports = click.option(
    "-p",
    "--port",
    "ports",
    type=IntegerRange(1, 65535),
    multiple=True,
    help="Port of a server, 5007 unless given; may be repeated. Talks between other ports are recognised by "
    "what is said in them.",
)

color = click.option(
    "--color",
    type=click.Choice(["auto", "always", "never"]),
    default="auto",
    show_default=True,
    help="Colours: auto is for terminals without NO_COLOR.",
)

time_format = click.option(
    "--time",
    "clock",
    type=click.Choice([clock.value for clock in TimeFormat]),
    default=TimeFormat.RELATIVE.value,
    show_default=True,
    help="How the time is told: seconds since the first frame, since the one before, in UTC, since 1970.",
)


window = click.option(
    "--window",
    metavar="SECONDS",
    type=NumberRange(0.1),
    callback=lambda context, parameter, value: None if value is None else round(value * 1e9),
    help="Figures for each slice of so many seconds, instead of the whole.",
)


def filter_option(kind: RecordKind) -> Callable[[F], F]:
    """Make the option ``--filter`` for records of `kind`; its value is a compiled filter or None."""

    def compile_it(context: click.Context, parameter: click.Parameter, value: str | None) -> Filter | None:
        try:
            return None if value is None else compile_filter(value, kind)
        except FilterError as error:
            raise click.BadParameter(f"\n{error}", context, parameter) from None

    return click.option(
        "-f",
        "--filter",
        "wanted",
        metavar="EXPRESSION",
        callback=compile_it,
        help="Show only what this is true for, such as 'command ~ \"slv\" and hresult != S_OK'; see "
        "`bcapscope fields`.",
    )


def output_option(help_: str, allow_dash: bool = False) -> Callable[[F], F]:
    """Make the option ``--output`` for the path of what a command writes.

    Args:
        help_: where to.
        allow_dash: ``-`` is standard output.
    """
    kind = click.Path(path_type=Path, allow_dash=allow_dash)
    return click.option("-o", "--output", required=True, metavar="FILE", type=kind, help=help_)
