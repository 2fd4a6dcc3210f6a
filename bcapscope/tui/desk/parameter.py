"""Parameters as they are typed: a type chosen from a list, a value beside it, checked at once."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.commands import Command, command
from bcapscope.protocol.notation import parse
from bcapscope.protocol.variant import ARRAY, VT, Variant, vt_name
from bcapscope.render.notation import type_word
from bcapscope.tui.words import say, told

TYPES: tuple[int, ...] = (
    *(int(vt) for vt in VT if vt is not VT.VARIANT),
    *(ARRAY | vt for vt in VT if vt not in (VT.EMPTY, VT.NULL)),
)
"""Every type that b-CAP carries, scalars first."""


def type_label(vt: int) -> str:
    """Name a type as b-CAP Tester does: ``I4``, ``ARRAY | R4``."""
    name = vt_name(vt & ~ARRAY).removeprefix("VT_")
    return f"ARRAY | {name}" if vt & ARRAY else name


_BY_NAME = {vt_name(vt): vt for vt in TYPES}


def type_of(name: str) -> int | None:
    """Return the number of a type such as ``VT_R4|VT_ARRAY``; None for ``VARIANT``, which is any."""
    return _BY_NAME.get(name)


class Checked(NamedTuple):
    """What typed text comes to.

    Attributes:
        value: None where the text does not go with the type.
        problem: what is expected then; else empty.
    """

    value: Variant | None
    problem: str


def check(vt: int, text: str) -> Checked:
    """Read what was typed for a type."""
    typed = text if vt == VT.BSTR else text.strip()
    try:
        return Checked(parse(f"{type_word(vt)}:{typed}"), "")
    except ValueError as error:
        return Checked(None, f"{told(str(error))}; {expected(vt)}")


def expected(vt: int) -> str:
    """Say what is to be typed for a type."""
    if vt in (VT.EMPTY, VT.NULL):
        return say("desk.expected.nothing")
    what = say(f"desk.expected.{VT(vt & ~ARRAY).name}")
    several = vt & ARRAY and vt != ARRAY | VT.VARIANT
    return say("desk.expected.several" if several else "desk.expected", what=what)


class Suggestion(NamedTuple):
    """What the catalogue says of a command.

    Attributes:
        types: of its parameter, the most usual first.
        text: what it does and what its parameter holds.
    """

    types: tuple[int, ...]
    text: str


def suggestion(function_id: int, name: str) -> Suggestion | None:
    """Look a command up; None for one that is not known."""
    known = command(function_id, name.strip())
    if known is None:
        return None
    types = tuple(vt for each in known.parameter_types if (vt := type_of(each)) is not None)
    return Suggestion(types, _words(known))


def _words(known: Command) -> str:
    parts = [told(known.text)]
    if known.elements:
        parts.append(say("desk.command.parameter", elements=told(known.elements)))
    if known.returns:
        parts.append(say("desk.command.returns", returns=told(known.returns)))
    if known.in_slave_mode is False:
        parts.append(say("desk.command.refused"))
    if known.controllers:
        parts.append(told(known.controllers))
    return "; ".join(parts)
