"""Templates that write the arguments of a frame as one line of text. Frames that differ only in their numbers
share a template."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.frame_template import FrameNumbers, iter_numbers, number_count, number_counts
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.protocol.tables.function_table import Param
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.escape import quoted
from bcapscope.render.number import (
    currency_text,
    date_text,
    number_text,
    numbers_text,
    single_text,
    singles_text,
)

LONGEST_STRING = 120
"""Maximum number of characters of a string that a line shows.

A line shows half as many bytes of a UI1 array.
"""

MAX_ELEMENTS = 32
"""Maximum number of elements of an array that a line shows."""

NumberWriter: TypeAlias = Callable[[Any], str]
TemplatePlace: TypeAlias = tuple[int | slice, NumberWriter]
"""Placeholder in a template. The index or slice selects some of a frame's numbers, and the function formats
these numbers.
"""

_SHOWN_BEFORE = ("bstrCommand",)
"""Arguments to leave out, because the line already shows their values next to the function's name."""


class LineTemplate:
    """A %-format for a line of text: first the formats of its head, then ``%s`` for each placeholder."""

    __slots__ = ("places", "text")

    def __init__(self, text: str, places: Sequence[TemplatePlace]) -> None:
        self.text = text
        self.places = tuple(places)

    def fill(self, head: tuple[object, ...], numbers: FrameNumbers) -> str:
        return self.text % (*head, *[write(numbers[where]) for where, write in self.places])


class LineTemplateBuilder:
    def __init__(self, head: str = "") -> None:
        """Start the template with `head`, which is a %-format."""
        self._pieces = [head]
        self._places: list[TemplatePlace] = []
        self._numbers_placed = 0

    def add_text(self, text: str) -> None:
        self._pieces.append(text.replace("%", "%%"))

    def add_arguments(self, arguments: Sequence[Argument], role: Callable[[int], Param]) -> None:
        """Add arguments as ``name=value``. Add the type of each argument that has an unexpected type."""
        for index, (argument, taken) in enumerate(zip(arguments, number_counts(arguments), strict=True)):
            param = role(index)
            if param.name in _SHOWN_BEFORE and isinstance(argument.variant.value, str):
                continue
            self.add_text(f" {param.name}=")
            typed = vt_name(argument.variant.vt) != param.type
            if taken:
                self.add_variant(argument.variant, typed)
            else:
                self._add_constant(argument.variant, typed)

    def add_variant(self, variant: Variant, typed: bool = True) -> None:
        base = variant.vt & ~ARRAY
        if variant.vt & ARRAY:
            self._add_array(base, variant)
        elif base in NUMBER_FORMATS and variant.value is not None:
            self._add_scalar(base, variant, typed)
        else:
            self.add_text(_constant(variant))

    def build(self) -> LineTemplate:
        return LineTemplate("".join(self._pieces), self._places)

    def _add_constant(self, variant: Variant, typed: bool) -> None:
        """Add a value that is the same in all frames that share the template."""
        builder = LineTemplateBuilder()
        builder.add_variant(variant, typed)
        self.add_text(builder.build().fill((), tuple(iter_numbers(variant))))

    def _add_scalar(self, base: int, variant: Variant, typed: bool) -> None:
        if base == VT.BOOL:
            self.add_text("true" if variant.value else "false")
            return
        if typed:
            self.add_text(f"{VT(base).name}(")
        self._add_place(self._reserve_numbers(1).start, _WRITERS[base])
        if typed:
            self.add_text(")")

    def _reserve_numbers(self, count: int) -> slice:
        start = self._numbers_placed
        self._numbers_placed += count
        return slice(start, self._numbers_placed)

    def _add_place(self, where: int | slice, write: NumberWriter) -> None:
        self._pieces.append("%s")
        self._places.append((where, write))

    def _add_array(self, base: int, variant: Variant) -> None:
        value = variant.value
        if base != VT.VARIANT:
            self.add_text(_type_word(base))
        self.add_text("[")
        if isinstance(value, bytes):
            if number_count(variant):
                self._add_place(self._reserve_numbers(1).start, _bytes_text)
            else:
                self.add_text(_bytes_text(value))
        elif isinstance(value, tuple):
            self._add_elements(base, value)
            if len(value) > MAX_ELEMENTS:
                self.add_text(f",… {len(value) - MAX_ELEMENTS} more")
        self.add_text("]")

    def _add_elements(self, base: int, values: tuple[object, ...]) -> None:
        shown = values[:MAX_ELEMENTS]
        if base in _WRITERS:
            taken = self._reserve_numbers(len(values))
            where = slice(taken.start, taken.start + len(shown))
            self._add_place(where, _LIST_WRITERS.get(base) or partial(_joined, _WRITERS[base]))
            return
        for index, value in enumerate(shown):
            if index:
                self.add_text(",")
            if isinstance(value, Variant):
                self.add_variant(value)
            else:
                self.add_text(_element_text(value))
        self._reserve_numbers(
            sum(number_count(value) for value in values[MAX_ELEMENTS:] if isinstance(value, Variant))
        )


def _constant(variant: Variant) -> str:
    if isinstance(variant.value, str):
        return _string_text(variant.value)
    if variant.vt in (VT.EMPTY, VT.NULL):
        return VT(variant.vt).name
    if isinstance(variant.value, bytes):
        return f"{vt_name(variant.vt)}({_bytes_text(variant.value)})"
    return f"{vt_name(variant.vt)}(?)"


def _element_text(value: object) -> str:
    if isinstance(value, str):
        return _string_text(value)
    return "true" if value else "false"


def _string_text(text: str) -> str:
    if len(text) <= LONGEST_STRING:
        return quoted(text)
    return f"{quoted(text[:LONGEST_STRING])}… {len(text) - LONGEST_STRING} more"


def _bytes_text(data: bytes) -> str:
    most = LONGEST_STRING // 2
    more = f"… {len(data) - most} more" if len(data) > most else ""
    return data[:most].hex() + more


def _type_word(base: int) -> str:
    return VT(base).name if base in VT.__members__.values() else vt_name(base)


def _joined(write: NumberWriter, values: tuple[int | float, ...]) -> str:
    return ",".join(map(write, values))


def _date_text(days: float) -> str:
    text = date_text(days)
    return f"{days!r} {text}" if text else repr(days)


_WRITERS: dict[int, NumberWriter] = {
    VT.I2: str,
    VT.I4: str,
    VT.R4: single_text,
    VT.R8: number_text,
    VT.CY: lambda raw: f"{raw} {currency_text(raw)}",
    VT.DATE: _date_text,
    VT.ERROR: hresult_name,
    VT.UI1: str,
    VT.UI2: str,
    VT.UI4: str,
    VT.I8: str,
    VT.UI8: str,
}
_LIST_WRITERS: dict[int, NumberWriter] = {
    VT.R4: singles_text,
    **{vt: numbers_text for vt in (VT.I2, VT.I4, VT.R8, VT.UI2, VT.UI4, VT.I8, VT.UI8)},
}
