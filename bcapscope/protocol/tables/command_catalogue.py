"""The catalogue of commands (`commands.tsv`) that clients request with Robot_Execute and similar functions.

Controllers and this catalogue ignore the case of command names. The slides of DENSO Wave 2009, How to use the
Slave mode, show both `SLVMOVE` and `slvMove`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, function_name
from bcapscope.protocol.tables.table_rows import table_rows

COBOTTA, COBOTTA_PRO = "COBOTTA", "COBOTTA PRO"
"""Names of controllers in the table of commands."""

COMMAND_FUNCTIONS = frozenset(
    function.id
    for function in FUNCTIONS.values()
    if len(function.params) > 1 and function.params[1].name == "bstrCommand"
)
"""The ..._Execute functions, which take a command name as their second argument."""

_POSE = "BSTR R8[] R4[] V[]"
_LONGEST_COMPARED = 40
LEAST_SIMILARITY = 0.7
"""Minimum ratio of difflib for similar names; slvChangeMode with two letters swapped has 0.92."""


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """A command of a function such as Robot_Execute.

    Attributes:
        function_id: Id of the function that takes the command: 17, 28, 64 or 87.
        parameter_types: Accepted types of vntParam, such as `VT_I4|VT_ARRAY`.
        elements: Meaning of the parameter or of its elements in order.
        result_types: Possible types of the result; `none` if the reply has no value; () if unknown.
        in_slave_mode: Whether the controller accepts the command in slave mode; None if no source says.
        controllers: Controllers, providers or objects that have the command; empty if unknown.
    """

    function_id: int
    name: str
    parameter_types: tuple[str, ...]
    elements: str
    result_types: tuple[str, ...]
    returns: str
    text: str
    effect: CallEffect
    in_slave_mode: bool | None
    controllers: str


def find_command(function_id: int, name: str) -> CommandSpec | None:
    """Find a command by function and name, ignoring case; return None if the command is unknown."""
    return _BY_KEY.get((function_id, name.casefold()))


def similar_command(function_id: int, name: str) -> str | None:
    """Return the function's known command that is most similar to `name`; None if no command is similar."""
    return _similar_command(function_id, name[:_LONGEST_COMPARED].casefold())


@lru_cache(256)
def _similar_command(function_id: int, folded_name: str) -> str | None:
    known = {each.name.casefold(): each.name for each in commands_of(function_id)}
    close = get_close_matches(folded_name, known, n=1, cutoff=LEAST_SIMILARITY)
    return next((known[name] for name in close), None)


def commands_of(function_id: int) -> tuple[CommandSpec, ...]:
    return _BY_FUNCTION.get(function_id, ())


def call_name(function_id: int, arguments: Sequence[Variant]) -> str:
    """Return the name of a call for display: function and command, such as `Robot_Execute slvMove`."""
    name = command_name(function_id, arguments)
    return function_name(function_id) + (f" {name}" if name else "")


def command_name(function_id: int, arguments: Sequence[Variant]) -> str | None:
    """Return the command of a request, in the client's spelling; None if the request names no command."""
    if function_id not in COMMAND_FUNCTIONS or len(arguments) < 2:
        return None
    value = arguments[1].value
    return value if isinstance(value, str) else None


def command_parameter(arguments: Sequence[Variant]) -> Variant | None:
    """Return the argument vntParam of an ..._Execute call; None if this argument is missing."""
    return arguments[2] if len(arguments) > 2 else None


def _full_type_name(short: str) -> str:
    if short == "none":
        return short
    base = {"-": "EMPTY", "V": "VARIANT"}.get(short.removesuffix("[]"), short.removesuffix("[]"))
    return f"VT_{base}|VT_ARRAY" if short.endswith("[]") else f"VT_{base}"


def _full_type_names(short: str) -> tuple[str, ...]:
    return tuple(_full_type_name(word) for word in short.replace("pose", _POSE).split())


def _specs_of_row(row: dict[str, str]) -> Iterator[CommandSpec]:
    for name in row["names"].split():
        yield CommandSpec(
            function_id=ID[row["function"]],
            name=name,
            parameter_types=_full_type_names(row["parameter"]),
            elements=row["elements"],
            result_types=_full_type_names(row["result"].removesuffix("~")),
            returns=row["returns"],
            text=row["text"],
            effect=CallEffect[row["effect"].upper()],
            in_slave_mode={"yes": True, "no": False}.get(row["slave"]),
            controllers=row["controllers"],
        )


_COMMANDS = [command for row in table_rows("commands") for command in _specs_of_row(row)]
_BY_FUNCTION = {
    function_id: tuple(each for each in _COMMANDS if each.function_id == function_id)
    for function_id in {each.function_id for each in _COMMANDS}
}
_BY_KEY = {(each.function_id, each.name.casefold()): each for each in _COMMANDS}
