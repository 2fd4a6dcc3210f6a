"""Arguments as one line of text, made once for all frames of a layout.

A phrase is a text with places left open for numbers: the words are chosen when the first frame of a form
is met, and each frame after it only fills its own numbers in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from decimal import Decimal
from typing import TypeAlias

from bcapscope.protocol.arguments import Argument
from bcapscope.protocol.functions import Param
from bcapscope.protocol.hresult import hresult_name
from bcapscope.protocol.layout import Numbers, numbers_taken
from bcapscope.protocol.variant import ARRAY, CY_SCALE, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.render.escape import printable, quoted

LONGEST_STRING = 120
"""Characters of a string, and half as many bytes of a UI1 array, that one line shows."""

MOST_ELEMENTS = 32
"""Elements of an array that one line shows."""

Converter: TypeAlias = Callable[[int | float | bytes], str]

_DATE_ZERO = datetime(1899, 12, 30)
_HANDED_OVER = ("bstrCommand",)
_SWALLOW = "%.0s"


def date_text(days: float) -> str:
    """Write a DATE as date and time; empty where no calendar has one.

    Days since 1899-12-30 00:00. Before that OLE and DENSO's Python client count the fraction in opposite
    directions, so only the number itself is certain there. The time zone is the sender's secret: C and
    Python send UTC, C# local time (orin_bcap).
    """
    if not 0 <= days < 2_958_466:
        return ""
    return str((_DATE_ZERO + timedelta(days=days)).replace(microsecond=0))


def cy_text(raw: int) -> str:
    """Write a CY in the unit that COM gives it."""
    return str(Decimal(raw) / CY_SCALE)


_FLOATS = {int(VT.R4): "%.7g", int(VT.R8): "%.9g"}
"""A line shows the digits that R4 holds, and of R8's fifteen those that a robot can tell apart."""


class Phrase:
    """A text with places for numbers."""

    __slots__ = ("_converters", "_text")

    def __init__(self, text: str, converters: Sequence[Converter | None]) -> None:
        self._text = text
        self._converters = tuple(converters) if any(converters) else None

    def fill(self, numbers: Numbers) -> str:
        """Put a frame's numbers in, in the order of its bytes."""
        if self._converters is not None:
            pairs = zip(self._converters, numbers, strict=True)
            numbers = tuple(number if convert is None else convert(number) for convert, number in pairs)  # type: ignore[misc]
        return self._text % numbers


class PhraseBuilder:
    """Collects the pieces of a phrase, left to right."""

    def __init__(self) -> None:
        self._pieces: list[str] = []
        self._converters: list[Converter | None] = []

    def text(self, text: str) -> None:
        """Add words."""
        self._pieces.append(text.replace("%", "%%"))

    def arguments(self, arguments: Sequence[Argument], role: Callable[[int], Param]) -> None:
        """Add arguments as ``name=value``; a type is named where the function does not prescribe it."""
        for index, argument in enumerate(arguments):
            param = role(index)
            if param.name in _HANDED_OVER and isinstance(argument.variant.value, str):
                continue
            self.text(f" {param.name}=")
            self.variant(argument.variant, vt_name(argument.variant.vt) != param.type)

    def variant(self, variant: Variant, typed: bool = True) -> None:
        """Add a value."""
        base = variant.vt & ~ARRAY
        if variant.vt & ARRAY:
            self._array(base, variant)
        elif base in NUMBER_FORMATS and variant.value is not None:
            self._scalar(base, variant, typed)
        else:
            self.text(_constant(variant))

    def done(self) -> Phrase:
        """Return what was collected."""
        return Phrase("".join(self._pieces), self._converters)

    def _scalar(self, base: int, variant: Variant, typed: bool) -> None:
        if base == VT.BOOL:
            self.text("true" if variant.value else "false")
            return
        if typed:
            self.text(f"{VT(base).name}(")
        self._number(base)
        if typed:
            self.text(")")

    def _number(self, base: int) -> None:
        converter = _CONVERTERS.get(base)
        self._pieces.append("%s" if converter else _FLOATS.get(base, "%d"))
        self._converters.append(converter)

    def _array(self, base: int, variant: Variant) -> None:
        value = variant.value
        if isinstance(value, bytes):
            self.text(f"{_type_word(base)}[")
            if numbers_taken(variant):
                self._pieces.append("%s")
                self._converters.append(_bytes_text)
            else:
                self.text(_bytes_text(value))
        elif isinstance(value, tuple):
            self.text("[" if base == VT.VARIANT else f"{_type_word(base)}[")
            self._elements(base, value)
        self.text("]")

    def _elements(self, base: int, values: tuple[object, ...]) -> None:
        for index, value in enumerate(values[:MOST_ELEMENTS]):
            if index:
                self.text(", ")
            if isinstance(value, Variant):
                self.variant(value)
            elif base in NUMBER_FORMATS and base != VT.BOOL:
                self._number(base)
            else:
                self.text(_element_text(value))
        if len(values) > MOST_ELEMENTS:
            self.text(f", … {len(values) - MOST_ELEMENTS} more")
            left = sum(_taken(base, value) for value in values[MOST_ELEMENTS:])
            self._pieces.append(_SWALLOW * left)
            self._converters += [None] * left


def _taken(base: int, value: object) -> int:
    if isinstance(value, Variant):
        return numbers_taken(value)
    return int(base in NUMBER_FORMATS and base != VT.BOOL)


def _constant(variant: Variant) -> str:
    if isinstance(variant.value, str):
        return _string(variant.value)
    if variant.vt in (VT.EMPTY, VT.NULL):
        return VT(variant.vt).name
    if isinstance(variant.value, bytes):
        return f"{vt_name(variant.vt)}({_bytes_text(variant.value)})"
    return f"{vt_name(variant.vt)}(?)"


def _element_text(value: object) -> str:
    if isinstance(value, str):
        return _string(value)
    return "true" if value else "false"


def _string(text: str) -> str:
    if len(text) <= LONGEST_STRING:
        return quoted(text)
    return f"{quoted(text[:LONGEST_STRING])}… {len(text) - LONGEST_STRING} more"


def _bytes_text(value: int | float | bytes) -> str:
    data = value if isinstance(value, bytes) else b""
    most = LONGEST_STRING // 2
    more = f"… {len(data) - most} more" if len(data) > most else ""
    return data[:most].hex() + more


def _type_word(base: int) -> str:
    return VT(base).name if base in VT.__members__.values() else vt_name(base)


def _date(value: int | float | bytes) -> str:
    days = float(value)
    text = date_text(days)
    return f"{days!r} {text}" if text else repr(days)


_CONVERTERS: dict[int, Converter] = {
    VT.CY: lambda raw: f"{raw!r} {cy_text(int(raw))}",
    VT.DATE: _date,
    VT.ERROR: lambda code: printable(hresult_name(int(code))),
}
