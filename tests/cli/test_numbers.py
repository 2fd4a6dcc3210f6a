"""No number that a user types reaches arithmetic unbounded: each option refuses it in one sentence.

The options come from the command tree, so that a new one is tested too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.cli import cli
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.protocol.number_parsing import LONGEST_NUMBER, parse_integer, parse_number
from tests.cli.run import run

LARGEST = 2**64
"""No option takes a number beyond this."""

HOSTILE = {
    "310 nines": "9" * 310,
    "5000 nines": "9" * 5000,
    "minus 400 nines": "-" + "9" * 400,
    "1e400": "1e400",
    "-1e400": "-1e400",
    "an exponent of nine digits": "1e999999999",
    "nan": "nan",
    "inf": "inf",
    "-Infinity": "-Infinity",
    "5000 hexadecimal digits": "0x" + "f" * 5000,
    "a fraction of 400 digits": "0." + "0" * 400 + "1",
    "Arabic digits": "\u0663",
    "a superscript": "\u00b2",
    "a Roman numeral": "\u2163",
    "wide digits": "\uff11\uff12",
    "an underscore": "1_000",
    "a division": "1/0",
    "nothing": "",
}


def walk(
    command: click.Command, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield every command with the words that call it."""
    yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from walk(found, (*path, name))


COMMANDS = dict(walk(cli))
PARAMETERS = [
    pytest.param(path, parameter, id=f"{' '.join(path)} {parameter.name}")
    for path, command in COMMANDS.items()
    for parameter in command.params
    if not getattr(parameter, "is_flag", False) and parameter.expose_value
]
NUMBERS = (
    click.types.IntParamType,
    click.types.FloatParamType,
)


def read(path: tuple[str, ...], parameter: click.Parameter, text: str) -> object:
    """Read a parameter as click does, callbacks included."""
    context = click.Context(COMMANDS[path], info_name="bcapscope")
    values = (text,) if parameter.multiple or parameter.nargs != 1 else text
    with click.core.augment_usage_errors(context, parameter):
        return parameter.process_value(context, values)


@pytest.mark.parametrize(("path", "parameter"), PARAMETERS)
def test_hostile_numbers_are_refused_or_bounded(path: tuple[str, ...], parameter: click.Parameter) -> None:
    for text in HOSTILE.values():
        refusal = None
        try:
            value = read(path, parameter, text)
        except click.UsageError as error:
            refusal = error
        if refusal is None:
            assert not isinstance(parameter.type, NUMBERS), f"{text[:40]!r} was read as {value!r}"
            check_bounded(value)
        else:
            check_message(refusal, parameter, text)


def check_message(refusal: click.UsageError, parameter: click.Parameter, text: str) -> None:
    """Check that a refusal names the parameter and has nothing that Python says to programmers."""
    message = refusal.format_message()
    assert len(message) < 600 + 2 * len(text)
    assert "set_int_max_str_digits" not in message
    assert parameter.human_readable_name.upper() in message or parameter.opts[-1] in message
    assert refusal.exit_code == ExitCode.USAGE
    if isinstance(parameter.type, NUMBERS):
        assert len(message) < 200
        assert "\n" not in message


def check_bounded(value: object) -> None:
    """Check that every number inside a value that an option gave is small and finite."""
    if isinstance(value, tuple | list):
        for each in value:
            check_bounded(each)
    elif isinstance(value, int | float):
        assert abs(value) <= LARGEST


@pytest.mark.parametrize(("path", "parameter"), PARAMETERS)
def test_numeric_options_name_their_bounds(path: tuple[str, ...], parameter: click.Parameter) -> None:
    kind = parameter.type
    if not isinstance(kind, NUMBERS):
        return
    assert isinstance(kind, click.IntRange | click.FloatRange), "a number has bounds"
    assert kind.min is not None
    assert kind.max is not None
    assert -LARGEST <= kind.min < kind.max <= LARGEST
    for text in (f"{kind.min - 1}", f"{kind.max + 1}", "x"):
        with pytest.raises(click.BadParameter, match=f"from {kind.min:.10g} to ({kind.max}|{kind.max:.10g})"):
            read(path, parameter, text)
    for number in (kind.min, kind.max):
        assert read(path, parameter, f"{number}") is not None


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_a_message_is_short_whatever_was_typed(text: str) -> None:
    done = run("sim", "--scenario", text)
    assert done.code == ExitCode.USAGE
    assert len(done.err) < 3000


def test_the_command_tree_has_numeric_options() -> None:
    found = [
        each for command in COMMANDS.values() for each in command.params if isinstance(each.type, NUMBERS)
    ]
    assert len(found) > 25


@given(st.text())
def test_any_text_is_a_bounded_number_or_none(text: str) -> None:
    integer, number = parse_integer(text, -5, 5), parse_number(text, -5.0, 5.0)
    assert integer is None or -5 <= integer <= 5
    assert number is None or -5 <= number <= 5


@given(st.integers(-(2**64), 2**64))
def test_integers_are_read(number: int) -> None:
    assert parse_integer(f" {number} ", -(2**64), 2**64) == number
    assert parse_integer(f"{number:+}", number, number) == number
    if number >= 0:
        assert parse_integer(f"0x{number:x}", 0, 2**64) == number
    assert parse_integer(f"{number}", number + 1, number + 2) is None


@given(st.floats(-1e30, 1e30))
def test_numbers_are_read(number: float) -> None:
    assert parse_number(repr(number), -1e30, 1e30) == number
    assert parse_number(f"{number:.3e}", -1e31, 1e31) == float(f"{number:.3e}")


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_hostile_numbers_are_none(text: str) -> None:
    assert parse_integer(text, -(10**30), 10**30) is None
    assert parse_number(text, -1e30, 1e30) is None
    assert math.isfinite(parse_number("9" * LONGEST_NUMBER, 0, 1e300) or 0)
