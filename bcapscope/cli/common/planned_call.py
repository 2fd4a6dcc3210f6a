"""Parse calls that the user types. The user types the name of a function, then its arguments."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import click

from bcapscope.cli.common.target_options import ControllerTarget
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.codec.variant_notation import parse_variant_as
from bcapscope.protocol.tables.command_catalogue import find_command
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass, Param, function_by_name
from bcapscope.protocol.tables.variables import find_variable
from bcapscope.protocol.text_format import shortened

LONGEST_LINE = 65536
"""Maximum number of characters in a line of a script."""

_LONGEST_SHOWN = 60  # maximum number of characters of an argument that a message quotes

_OWNERS_OF_VARIABLES = (ObjectClass.CONTROLLER, ObjectClass.ROBOT, ObjectClass.TASK)
_NAMELESS_OWNERS = (ObjectClass.SERVICE, ObjectClass.CONTROLLER, ObjectClass.MESSAGE)


@dataclass(frozen=True, slots=True)
class PlannedCall:
    """A call to make. If `opens_object` is True, the handle of an object comes before `values`."""

    function: Function
    values: tuple[Variant, ...]
    opens_object: bool

    async def arguments(self, opener: ObjectOpener) -> tuple[Variant, ...]:
        if self.opens_object:
            return (Variant(VT.I4, await opener.handle_for(self.function.owner)), *self.values)
        if self.function.name == "Controller_Connect":
            await opener.start_service()
        return self.values


class PlannedCallParser:
    def __init__(self, target: ControllerTarget, variable_name: str | None) -> None:
        """Parse calls to `target`. `variable_name` is the name of the variable that the calls use."""
        self._target = target
        self._types = _variable_types(variable_name, _OWNERS_OF_VARIABLES) if variable_name else ()

    def parse(self, words: Sequence[str]) -> PlannedCall:
        """Parse one call.

        Raises:
            click.UsageError: the function is unknown, or the arguments do not match it.
        """
        name, *texts = words
        function = function_by_name(name)
        if function is None:
            near = get_close_matches(name, [each.name for each in FUNCTIONS.values()], 1)
            hint = f". Did you mean {near[0]}?" if near else ""
            raise click.UsageError(f"unknown function {name!r}{hint}")
        params = function.params
        takes_handle = function.takes_handle and not _begins_with_handle(params, texts)
        if takes_handle:
            params = params[1:]
        if len(texts) > len(params):
            raise click.UsageError(_too_many_text(function, params, texts))
        defaults = {"Controller_Connect": self._target.connect, "Service_Start": (self._target.service,)}
        texts = [*texts, *defaults.get(function.name, ())[len(texts) :]]
        types = self._types if takes_handle and function.name == "Variable_PutValue" else ()
        values = tuple(
            _parse_argument(function, index, param, texts, types) for index, param in enumerate(params)
        )
        if function.creates is ObjectClass.VARIABLE:
            opened = str(values[0 if takes_handle else 1].value)
            self._types = _variable_types(opened, (function.owner,))
        return PlannedCall(function, values, takes_handle)

    def parse_script(self, lines: Iterable[str]) -> list[PlannedCall]:
        """Parse one call per line. Each line is split into words as a shell does. Empty lines and # comments
        are skipped.

        Raises:
            click.UsageError: a line is invalid, too long, or not UTF-8.
        """
        requests = []
        number = 1
        try:
            for line in lines:
                if len(line) > LONGEST_LINE:
                    raise ValueError(f"longer than {LONGEST_LINE} characters")
                words = shlex.split(line, comments=True)
                if words:
                    requests.append(self.parse(words))
                number += 1
        except UnicodeError:
            raise click.UsageError(f"line {number} or later: not UTF-8") from None
        except (ValueError, click.UsageError) as error:
            reason = error.message if isinstance(error, click.UsageError) else str(error).lower()
            raise click.UsageError(f"line {number}: {reason}") from None
        return requests


def check_owners(requests: Iterable[PlannedCall], named: Collection[ObjectClass]) -> None:
    """Check that each call that needs an object has one: the user named the object with an option, or an
    earlier call opens it.

    Raises:
        click.UsageError: a call needs an object that is neither named nor opened.
    """
    always = {*_NAMELESS_OWNERS, *named}
    known = set(always)
    for request in requests:
        owner = request.function.owner
        if request.opens_object and owner not in known:
            word = owner.lower()
            raise click.UsageError(
                f"{request.function.name} needs a {word}. Add --{word} NAME, or open one in an earlier call"
            )
        if request.function.creates is not None:
            known.add(request.function.creates)
        if request.function.releases is not None and request.opens_object and owner not in always:
            known.discard(owner)


def _begins_with_handle(params: Sequence[Param], texts: Sequence[str]) -> bool:
    """Return whether the user typed a handle first, although `call` adds the handle."""
    if len(texts) < len(params):
        return False
    try:
        return parse_variant_as(texts[0], [params[0].type]).vt == VT.I4
    except ValueError:
        return False


def _too_many_text(function: Function, params: Sequence[Param], texts: Sequence[str]) -> str:
    extra = texts[len(params) :]
    verb = "is" if len(extra) == 1 else "are"
    quoted = ", ".join(repr(shortened(text, _LONGEST_SHOWN)) for text in extra)
    text = f"{function.name} takes {_names_of(params)}; {quoted} {verb} too many"
    if params and params[-1].type == "VARIANT":
        joined = shortened(",".join(texts[len(params) - 1 :]), _LONGEST_SHOWN)
        text += f". If {params[-1].name} has several values, separate them with commas: {joined}"
    return text


def _names_of(params: Sequence[Param]) -> str:
    return " ".join(param.name for param in params) or "no arguments"


def _variable_types(variable_name: str, owners: Iterable[ObjectClass]) -> tuple[str, ...]:
    """Return the types that a variable of one of the `owners` can have; () if the variable is unknown."""
    known = (find_variable(owner, variable_name) for owner in owners)
    return next((kind.types for kind in known if kind), ())


def _parse_argument(
    function: Function, index: int, param: Param, texts: Sequence[str], types: Sequence[str]
) -> Variant:
    if index >= len(texts):
        if param.type == "VT_BSTR":
            return Variant(VT.BSTR, "")
        if param.type == "VARIANT":
            return EMPTY
        names = _names_of(function.params)
        raise click.UsageError(f"{function.name} takes {names}; {param.name} is missing")
    if param.name == "vntParam" and (known := find_command(function.id, texts[index - 1])):
        types = known.parameter_types
    try:
        return parse_variant_as(texts[index], types or [param.type])
    except ValueError as error:
        raise click.UsageError(f"{function.name}, {param.name}: {error}") from None
