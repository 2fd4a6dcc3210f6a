"""Parameters as they are typed: a type chosen from a list, a value beside it, checked at once."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.commands import Command, command
from bcapscope.protocol.notation import parse
from bcapscope.protocol.variant import ARRAY, VT, Variant, vt_name
from bcapscope.render.notation import type_word

_EXPECTED: dict[int, str] = {
    VT.I2: "a whole number, -32768 to 32767",
    VT.I4: "a whole number, -2147483648 to 2147483647, or 0x…",
    VT.R4: "a number",
    VT.R8: "a number",
    VT.CY: "a whole number: ten-thousandths",
    VT.DATE: "days since 1899-12-30",
    VT.BSTR: "text",
    VT.ERROR: "a result code as a signed whole number",
    VT.BOOL: "true or false",
    VT.UI1: "a whole number, 0 to 255",
    VT.UI2: "a whole number, 0 to 65535",
    VT.UI4: "a whole number, 0 to 4294967295",
    VT.I8: "a whole number of 64 bits",
    VT.UI8: "a whole number of 64 bits, not negative",
}
_VARIANTS = "values with their types, semicolons between, such as r8[]:10,20;bstr:J"

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
        return Checked(None, f"{error}; {expected(vt)}")


def expected(vt: int) -> str:
    """Say what is to be typed for a type."""
    if vt in (VT.EMPTY, VT.NULL):
        return "nothing is expected"
    if vt == ARRAY | VT.VARIANT:
        return f"expected: {_VARIANTS}"
    what = _EXPECTED.get(vt & ~ARRAY, "a value")
    return f"expected: {what}; several of it, commas between" if vt & ARRAY else f"expected: {what}"


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
    parts = [known.text]
    if known.elements:
        parts.append(f"parameter: {known.elements}")
    if known.returns:
        parts.append(f"returns {known.returns}")
    if known.in_slave_mode is False:
        parts.append("refused in slave mode")
    if known.controllers:
        parts.append(known.controllers)
    return "; ".join(parts)
