"""Arguments as one line of text, made once for all frames of a layout.

A phrase is a text with places left open for numbers: the words are chosen when the first frame of a form
is met, and each frame after it only fills its own numbers in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

from bcapscope.protocol.arguments import Argument
from bcapscope.protocol.functions import Param
from bcapscope.protocol.hresult import hresult_name
from bcapscope.protocol.layout import Numbers, numbers_of, numbers_taken, taken_by_each
from bcapscope.protocol.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.render.escape import quoted
from bcapscope.render.number import cy_text, date_text, plain_text, plain_texts, single_text, singles_text

LONGEST_STRING = 120
"""Characters of a string, and half as many bytes of a UI1 array, that one line shows."""

MOST_ELEMENTS = 32
"""Elements of an array that one line shows."""

Writer: TypeAlias = Callable[[Any], str]
Place: TypeAlias = tuple[int | slice, Writer]
"""Which of a frame's numbers stand here, and how they are written."""

_SPOKEN = ("bstrCommand",)
"""Arguments that the line shows beside the function's name."""


class Phrase:
    """A text with places for numbers.

    Attributes:
        text: a %-format: of its head first, then ``%s`` for each of `places`.
        places: which numbers stand there.
    """

    __slots__ = ("places", "text")

    def __init__(self, text: str, places: Sequence[Place]) -> None:
        self.text = text
        self.places = tuple(places)

    def fill(self, head: tuple[object, ...], numbers: Numbers) -> str:
        """Put in what stands at the head of the text, then a frame's numbers in the order of its bytes."""
        return self.text % (*head, *[write(numbers[where]) for where, write in self.places])


class PhraseBuilder:
    """Collects the pieces of a phrase, left to right."""

    def __init__(self, head: str = "") -> None:
        """Begin with `head`, a %-format of its own."""
        self._pieces = [head]
        self._places: list[Place] = []
        self._taken = 0

    def text(self, text: str) -> None:
        """Add words."""
        self._pieces.append(text.replace("%", "%%"))

    def arguments(self, arguments: Sequence[Argument], role: Callable[[int], Param]) -> None:
        """Add arguments as ``name=value``; a type is named where the function does not prescribe it."""
        for index, (argument, taken) in enumerate(zip(arguments, taken_by_each(arguments), strict=True)):
            param = role(index)
            if param.name in _SPOKEN and isinstance(argument.variant.value, str):
                continue
            self.text(f" {param.name}=")
            typed = vt_name(argument.variant.vt) != param.type
            if taken:
                self.variant(argument.variant, typed)
            else:
                self._settled(argument.variant, typed)

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
        return Phrase("".join(self._pieces), self._places)

    def _settled(self, variant: Variant, typed: bool) -> None:
        """Add a value whose numbers are the same in all frames of the layout."""
        builder = PhraseBuilder()
        builder.variant(variant, typed)
        self.text(builder.done().fill((), tuple(numbers_of(variant))))

    def _scalar(self, base: int, variant: Variant, typed: bool) -> None:
        if base == VT.BOOL:
            self.text("true" if variant.value else "false")
            return
        if typed:
            self.text(f"{VT(base).name}(")
        self._place(self._take(1).start, _WRITERS[base])
        if typed:
            self.text(")")

    def _take(self, count: int) -> slice:
        start = self._taken
        self._taken += count
        return slice(start, self._taken)

    def _place(self, where: int | slice, write: Writer) -> None:
        self._pieces.append("%s")
        self._places.append((where, write))

    def _array(self, base: int, variant: Variant) -> None:
        value = variant.value
        if base != VT.VARIANT:
            self.text(_type_word(base))
        self.text("[")
        if isinstance(value, bytes):
            if numbers_taken(variant):
                self._place(self._take(1).start, _bytes_text)
            else:
                self.text(_bytes_text(value))
        elif isinstance(value, tuple):
            self._elements(base, value)
            if len(value) > MOST_ELEMENTS:
                self.text(f",… {len(value) - MOST_ELEMENTS} more")
        self.text("]")

    def _elements(self, base: int, values: tuple[object, ...]) -> None:
        shown = values[:MOST_ELEMENTS]
        if base in _WRITERS:
            taken = self._take(len(values))
            where = slice(taken.start, taken.start + len(shown))
            self._place(where, _LISTS.get(base) or partial(_joined, _WRITERS[base]))
            return
        for index, value in enumerate(shown):
            if index:
                self.text(",")
            if isinstance(value, Variant):
                self.variant(value)
            else:
                self.text(_element_text(value))
        self._take(
            sum(numbers_taken(value) for value in values[MOST_ELEMENTS:] if isinstance(value, Variant))
        )


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


def _bytes_text(data: bytes) -> str:
    most = LONGEST_STRING // 2
    more = f"… {len(data) - most} more" if len(data) > most else ""
    return data[:most].hex() + more


def _type_word(base: int) -> str:
    return VT(base).name if base in VT.__members__.values() else vt_name(base)


def _joined(write: Writer, values: tuple[int | float, ...]) -> str:
    return ",".join(map(write, values))


def _date(days: float) -> str:
    text = date_text(days)
    return f"{days!r} {text}" if text else repr(days)


_WRITERS: dict[int, Writer] = {
    VT.I2: str,
    VT.I4: str,
    VT.R4: single_text,
    VT.R8: plain_text,
    VT.CY: lambda raw: f"{raw} {cy_text(raw)}",
    VT.DATE: _date,
    VT.ERROR: hresult_name,
    VT.UI1: str,
    VT.UI2: str,
    VT.UI4: str,
    VT.I8: str,
    VT.UI8: str,
}
_LISTS: dict[int, Writer] = {
    VT.R4: singles_text,
    **{vt: plain_texts for vt in (VT.I2, VT.I4, VT.R8, VT.UI2, VT.UI4, VT.I8, VT.UI8)},
}
