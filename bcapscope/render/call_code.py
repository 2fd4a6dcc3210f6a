"""Write a call as text to paste: a `bcapscope call` command line, a Python program, or hex bytes."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import (
    FUNCTIONS,
    Function,
    ObjectClass,
    Param,
    ResultKind,
    function_name,
)
from bcapscope.render.escape import printable
from bcapscope.render.value_text import typed_text

if TYPE_CHECKING:  # it reaches sockets
    from bcapscope.client.controller_target import ControllerTarget

_PORT = 5007
_PROVIDER = "CaoProv.DENSO.VRC"
"""Port and provider that `bcapscope call` uses by default."""

NAMED_OWNERS = (
    ObjectClass.ROBOT,
    ObjectClass.TASK,
    ObjectClass.VARIABLE,
    ObjectClass.FILE,
    ObjectClass.EXTENSION,
    ObjectClass.COMMAND,
)
"""Classes of objects that `bcapscope call` can open by name, with an option such as ``--robot``."""

_TYPES = {"VT_I4": VT.I4, "VT_R4": VT.R4, "VT_BSTR": VT.BSTR}
_WORD_BREAK = re.compile(r"(?<=[a-z])(?=[A-Z])")


def hex_text(raw: bytes) -> str:
    return raw.hex(" ").upper()


def shell_command(
    target: ControllerTarget, function_id: int, arguments: Sequence[Variant], subject: ObjectHandle | None
) -> str | None:
    """Return a `bcapscope call` command line that opens `subject` by its name and makes the call. Return None
    if `bcapscope call` does not know the function, or if no command line can express the call."""
    function = FUNCTIONS.get(function_id)
    if function is None or len(arguments) != len(function.params):
        return None
    skipped = 1 if subject is not None and _is_opened_by_call(subject) else 0
    pairs = list(zip(function.params, arguments, strict=True))[skipped:]
    texts = [argument_text(param, argument) for param, argument in pairs]
    if None in texts:
        return None
    names = _name_options(subject) if skipped else []
    words = ["bcapscope", "call", target.host, *_target_options(target), *names, function.name]
    values = [text for text in texts if text is not None]
    if any(text.startswith("-") for text in values):  # after `--`, a value such as -e is not an option
        words.append("--")
    line = shlex.join([*words, *values])
    return line if line == printable(line) else None


def _target_options(target: ControllerTarget) -> Iterator[str]:
    if target.port != _PORT:
        yield from ("--port", str(target.port))
    if target.tcp:
        yield "--tcp"
    if target.provider != _PROVIDER:
        yield from ("--provider", target.provider)
    if target.service:
        yield from ("--service", target.service)


def _is_opened_by_call(subject: ObjectHandle) -> bool:
    if subject.kind is ObjectClass.CONTROLLER:
        return True
    parent = subject.parent
    if (
        subject.kind not in NAMED_OWNERS
        or not subject.opened_with
        or parent is None
        or any(subject.opened_with[1:])
    ):
        return False
    return parent.kind is ObjectClass.CONTROLLER or (
        subject.kind is ObjectClass.VARIABLE and _is_opened_by_call(parent)
    )


def _name_options(subject: ObjectHandle | None) -> list[str]:
    words: list[str] = []
    while subject is not None and subject.kind in NAMED_OWNERS:
        words += [f"--{subject.kind.lower()}", subject.opened_with[0]]
        subject = subject.parent
    return words


def argument_text(param: Param, argument: Variant) -> str | None:
    """Return the text that users type for an argument, or None if the notation cannot express it."""
    if param.type == "VT_BSTR" and argument.vt == VT.BSTR and isinstance(argument.value, str):
        return argument.value
    return typed_text(argument)


def python_program(
    target: ControllerTarget, function_id: int, arguments: Sequence[Variant], subject: ObjectHandle | None
) -> str:
    """Return a Python program that connects, opens `subject`, makes the call and releases everything."""
    over = "over_tcp" if target.tcp else "over_udp"
    option = f", {_literal(target.service)}" if target.service else ""
    chain = _parents_and_self(subject)
    steps = [*_opening_lines(chain), *_call_lines(function_id, arguments, chain)]
    needs_variants = any("Variant(" in step or "Variant.array(" in step for step in steps)
    lines = [
        f"from bcapscope.client import Blocking, connect, {over}",
        *(["from bcapscope.protocol import VT, Variant"] if needs_variants else []),
        "",
        "with Blocking() as wait:",
        f"    service = wait.enter(connect({over}({_literal(target.host)}, {target.port}){option}))",
        *(f"    {step}" for step in steps),
    ]
    return "".join(f"{line}\n" for line in lines)


def _parents_and_self(subject: ObjectHandle | None) -> list[ObjectHandle]:
    chain: list[ObjectHandle] = []
    while subject is not None:
        chain.insert(0, subject)
        subject = subject.parent
    return chain


def _opening_lines(chain: Sequence[ObjectHandle]) -> Iterator[str]:
    owner = "service"
    for opened in chain:
        name = str(opened.kind.lower())
        verb = "connect" if opened.kind is ObjectClass.CONTROLLER else f"get_{name}"
        yield f"{name} = wait({owner}.{verb}({', '.join(map(_literal, _name_arguments(opened)))}))"
        owner = name


def _name_arguments(opened: ObjectHandle) -> Sequence[str]:
    match opened.kind:
        case ObjectClass.MESSAGE:
            return ()
        case ObjectClass.CONTROLLER:
            return opened.opened_with[:4]
    return opened.opened_with[:2] or ("",)


def _call_lines(
    function_id: int, arguments: Sequence[Variant], chain: Sequence[ObjectHandle]
) -> Iterator[str]:
    function = FUNCTIONS.get(function_id)
    subject = chain[-1].kind if chain else None
    if function is None or subject is not function.owner or not _has_method_types(function, arguments):
        yield from _call_by_number_lines(function_id, arguments, chain)
        return
    pairs = zip(function.params[1:], arguments[1:], strict=True)
    literals = ", ".join(_argument_literal(*pair) for pair in pairs)
    call = f"wait({subject.lower()}.{method_name(function)}({literals}))"
    yield call if function.result is ResultKind.NONE else f"print({call})"


def _call_by_number_lines(
    function_id: int, arguments: Sequence[Variant], chain: Sequence[ObjectHandle]
) -> Iterator[str]:
    values = list(map(_variant_literal, arguments))
    function = FUNCTIONS.get(function_id)
    if chain and arguments and arguments[0].value == chain[-1].handle:
        values[0] = f"Variant({_type(arguments[0].vt)}, {chain[-1].kind.lower()}.handle)"
    elif function is not None and function.takes_handle:
        yield f"# It is unknown how this {function.owner} was opened. Open the object and use its handle."
    yield f"# {function_name(function_id)}"
    yield f"print(wait(service.session.call({function_id}, [{', '.join(values)}])))"


def _has_method_types(function: Function, arguments: Sequence[Variant]) -> bool:
    return len(function.params) == len(arguments) and all(
        param.type == "VARIANT" or argument.vt == _TYPES[param.type]
        for param, argument in zip(function.params, arguments, strict=True)
    )


def method_name(function: Function) -> str:
    """Return the name of the method in `client.remote_objects` that calls a b-CAP function."""
    if function.releases is not None:
        return "release"
    return _WORD_BREAK.sub("_", function.name.partition("_")[2]).lower()


def _argument_literal(param: Param, argument: Variant) -> str:
    """Return an argument of a method as Python source. The method will convert the argument to a VARIANT."""
    if param.type in _TYPES:
        return _literal(argument.value)
    return "None" if argument == EMPTY else _variant_literal(argument)


def _variant_literal(variant: Variant) -> str:
    vt, value = variant.vt, variant.value
    if vt & ARRAY and isinstance(value, (tuple, bytes)):
        return f"Variant.array({_type(vt & ~ARRAY)}, {_literal(value)})"
    return f"Variant({_type(vt)}, {_literal(value)})"


def _type(vt: int) -> str:
    return f"VT.{VT(vt).name}" if vt in VT.__members__.values() else hex(vt)


def _literal(value: object) -> str:
    if isinstance(value, Variant):
        return _variant_literal(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else f'float("{value}")'
    if isinstance(value, tuple):
        inner = ", ".join(map(_literal, value))
        return f"({inner},)" if len(value) == 1 else f"({inner})"
    text = repr(value)
    return text if text.isascii() else printable(text)
