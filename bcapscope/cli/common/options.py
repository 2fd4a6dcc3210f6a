"""Options that several commands have."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Any, TypeAlias

import click

from bcapscope.cli.common.data_output import write_lines
from bcapscope.live.standard_streams import print_stderr
from bcapscope.messages import ENGLISH_WORDS, Language, MessageFormatter, language_of
from bcapscope.protocol.number_parsing import LONGEST_NUMBER, parse_integer, parse_number
from bcapscope.protocol.text_format import shortened
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.filter.compiler import Filter, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.joining.joined_observation import CapturePlace

Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]

LARGEST_SEED = 2**63 - 1
LARGEST_COUNT = 1_000_000_000
"""Maximum number of calls or rounds. At one call every 8 ms, a billion calls take three months."""

_LARGEST_NUMBER = 1_000_000.0
"""Default maximum of numeric options: 17 minutes for an option in ms, eleven days for one in s."""


class NumberRange(click.FloatRange):
    """A number between two bounds, which the user types in ASCII digits."""

    def __init__(self, minimum: float, maximum: float = _LARGEST_NUMBER) -> None:
        super().__init__(min=minimum, max=maximum)
        self.bounds = minimum, maximum

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = parse_number(str(value), *self.bounds)
        if number is None:
            low, high = self.bounds
            self.fail(f"{_quoted(value)} is not a number from {low:.10g} to {high:.10g}.", param, ctx)
        return number


class IntegerRange(click.IntRange):
    """An integer between two bounds, decimal or hexadecimal with the prefix 0x."""

    def __init__(self, minimum: int, maximum: int) -> None:
        super().__init__(min=minimum, max=maximum)
        self.bounds = minimum, maximum

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        number = parse_integer(str(value), *self.bounds)
        if number is None:
            low, high = self.bounds
            self.fail(f"{_quoted(value)} is not an integer from {low} to {high}.", param, ctx)
        return number


def _quoted(value: object) -> str:
    return repr(shortened(str(value), LONGEST_NUMBER))


def added(decorators: Sequence[Decorator]) -> Decorator:

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(decorators):
            function = option(function)
        return function

    return decorate


def bundled(
    parameter: str, make: Callable[..., object], decorators: Sequence[Decorator], names: Iterable[str] = ()
) -> Decorator:
    """Return a decorator that adds options to a command. The command gets the result of `make(**options)` as
    its argument `parameter`. `names` are the names of the options. Without `names`, each parameter of `make`
    is the name of an option.
    """
    own_names = tuple(names) or tuple(inspect.signature(make).parameters)

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def command(**given: Any) -> Any:
            own = {name: given.pop(name) for name in own_names if name in given}
            return function(**{parameter: make(**own)}, **given)

        return added(decorators)(command)

    return decorate


def parsed_by(read: Callable[[Any], Any]) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Return a click callback that parses each value of an option. `read` raises ValueError."""

    def convert(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
        try:
            if isinstance(value, tuple):
                return tuple(map(read, value))
            return None if value is None else read(value)
        except ValueError as error:
            separator = "\n" if "\n" in str(error) else ""
            raise click.BadParameter(f"{separator}{error}", context, parameter) from None

    return convert


_PATH = click.Path(allow_dash=True)

paths = click.argument("paths", nargs=-1, metavar="PATH...", type=_PATH)
"""Captures, which users may leave out if an option selects the input."""

captures = click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=_PATH)

interface = click.option(
    "-i",
    "--interface",
    metavar="NAME",
    help="Capture live on this interface until Ctrl-C or SIGTERM; `any` means all. Needs permission to "
    "capture.",
)

ports = click.option(
    "-p",
    "--port",
    "ports",
    type=IntegerRange(1, 65535),
    multiple=True,
    help="Expect controllers on this port (default: 5007); may be repeated. On all other ports, b-CAP is "
    "recognised by its content.",
)

side = click.option(
    "--side",
    type=click.Choice(["client", "controller"]),
    callback=parsed_by(lambda value: CapturePlace[f"{value.upper()}_SIDE"]),
    help="Show one side of a conversation that was captured at two places, such as on both legs of a proxy. "
    "By default, bcapscope joins the client's side and the controller's side.",
)

taken_at = click.option(
    "--taken-at",
    type=click.Choice([point.value for point in CapturePoint]),
    callback=parsed_by(CapturePoint),
    help="Where you captured: on the client's computer, at the controller, or between. If a reply was "
    "captured shortly before a retry, bcapscope needs the place to decide whether the reply was lost or "
    "late. By default, bcapscope infers the place from the traffic, if possible.",
)

color = click.option(
    "--color",
    type=click.Choice(["auto", "always", "never"]),
    default="auto",
    help="Use colours. auto: on a terminal, unless NO_COLOR is set.",
)

time_format = click.option(
    "--time",
    "clock",
    type=click.Choice([clock.value for clock in TimeFormat]),
    default=TimeFormat.RELATIVE.value,
    help="Show times as seconds since the first frame (relative), as seconds since the previous line "
    "(delta), as UTC, or as seconds since 1970 (epoch).",
)


window = click.option(
    "--window",
    metavar="SECONDS",
    type=NumberRange(0.1),
    callback=parsed_by(lambda seconds: round(seconds * 1e9)),
    help="Divide the total time into windows of this many seconds (minimum 0.1), and show figures for each "
    "window.",
)


def _words(context: click.Context, parameter: click.Parameter, value: str | None) -> MessageFormatter:
    return MessageFormatter(language_of(os.environ) if value is None else Language(value))


language = click.option(
    "--lang",
    "words",
    type=click.Choice([each.value for each in Language]),
    callback=_words,
    is_eager=True,  # click handles --lang first: callbacks of other options print text in the user's language
    help="Language of the text, en or ja. By default, LC_ALL, LC_MESSAGES or LANG decides. "
    "JSON and CSV stay English.",
)
"""Option ``--lang``. The command gets a formatter of messages in the user's language as `words`."""


def filter_option(kind: RecordKind) -> Decorator:

    def compile_it(context: click.Context, parameter: click.Parameter, value: str | None) -> Filter | None:
        compiled: Filter | None = parsed_by(lambda text: compile_filter(text, kind))(
            context, parameter, value
        )
        for warning in () if compiled is None else compiled.warnings:
            words: MessageFormatter = context.params.get("words", ENGLISH_WORDS)
            print_stderr(words("filter.warning", warning=warning))
        return compiled

    return click.option(
        "-f",
        "--filter",
        "wanted",
        metavar="EXPRESSION",
        callback=compile_it,
        help=f"Select {kind}s that match this filter, such as 'command ~ \"slv\" and hresult != S_OK'. "
        "`bcapscope fields` lists the fields.",
    )


def text_option(name: str, lines: Callable[[], Iterable[str]], help_: str) -> Decorator:
    """Return an option that prints `lines()` and exits, like ``--help``."""

    def print_lines(context: click.Context, parameter: click.Parameter, is_wanted: bool) -> None:
        if is_wanted and not context.resilient_parsing:
            write_lines(lines())
            context.exit()

    return click.option(
        name, is_flag=True, is_eager=True, expose_value=False, callback=print_lines, help=help_
    )


def choice_flag(choice: StrEnum, parameter: str, help_: str) -> Decorator:
    return click.option(
        f"--{choice}", parameter, flag_value=choice, type=type(choice), multiple=True, help=help_
    )


def output_option(help_: str, allow_dash: bool = False) -> Decorator:
    kind = click.Path(path_type=Path, allow_dash=allow_dash)
    return click.option("-o", "--output", required=True, metavar="FILE", type=kind, help=help_)


class _RecordPath(click.Path):
    def __init__(self) -> None:
        super().__init__(dir_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from bcapscope.capture.rotating_recording import is_named_pipe

        path = Path(value)
        return path if is_named_pipe(path) else super().convert(value, param, ctx)


def record_option(help_: str) -> Decorator:
    return click.option("--record", metavar="FILE.pcapng", type=_RecordPath(), help=help_)


def limit_option(help_: str) -> Decorator:
    examples = "may be repeated. Examples: J1=-170..170, J1..J3.speed=300, J1.acceleration=6000."
    return click.option("--limit", "limits", metavar="LIMIT", multiple=True, help=f"{help_}; {examples}")


def display_filter_option(what: str) -> Decorator:
    """`what` is the word for a record, such as "call"."""
    return click.option(
        "--display-filter",
        is_flag=True,
        help=f"Below each {what}, show the Wireshark display filter for the packets of the {what}.",
    )
