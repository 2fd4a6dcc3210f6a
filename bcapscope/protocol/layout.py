"""What frames of one form share, so that a million of them are decoded once.

Robot traffic repeats itself: two set points of a slave-mode session differ in serial, reserved and the
numbers inside their arguments, nothing else. The first of several arguments is a handle, of which there
are few: it belongs to the form. A `Layout` is what stays, kept from the first frame that
was decoded in full and found sound; a later frame that agrees with it byte for byte outside those
places needs only its numbers unpacked.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from bcapscope.protocol.arguments import Argument, Number
from bcapscope.protocol.variant import ARRAY, NUMBER_FORMATS, VT, Variant

Numbers: TypeAlias = "tuple[int | float | bytes, ...]"

_Filler: TypeAlias = Callable[[Variant, Numbers], Variant]
_Only: TypeAlias = "tuple[tuple[Variant, ...], _Filler, Variant, tuple[Variant, ...]]"
"""What stands before the only argument with numbers, what fills it, itself, and what stands behind it."""

LARGEST_FRAME = 1024
"""Longer frames are decoded one by one: they are rare, and keeping their bytes would cost more."""

MOST_LAYOUTS = 1024
"""Layouts kept in all; when more forms than that are met, all are forgotten and learnt again."""

MOST_SHAPES = 8
"""Shapes tried for one frame length."""


class Layout:
    """The form of a frame.

    Attributes:
        prototype: arguments of the frame it was learnt from; its numbers mean nothing.
    """

    __slots__ = ("_only", "_plan", "_variants", "prototype")

    def __init__(self, prototype: tuple[Argument, ...]) -> None:
        self.prototype = prototype
        self._variants = tuple(argument.variant for argument in prototype)
        self._plan: list[tuple[int, int, int, _Filler]] = []
        self._only: _Only | None = None
        begin = 0
        for place, taken in enumerate(taken_by_each(prototype)):
            if taken:
                self._plan.append((place, begin, begin + taken, _filler(prototype[place].variant)))
                begin += taken
        if len(self._plan) == 1:
            place, _, _, fill = self._plan[0]
            self._only = self._variants[:place], fill, self._variants[place], self._variants[place + 1 :]

    def arguments(self, numbers: Numbers) -> tuple[Argument, ...]:
        """Put a frame's own `numbers`, in the order of its bytes, into the arguments."""
        if not numbers:
            return self.prototype
        arguments = list(self.prototype)
        for place, begin, end, fill in self._plan:
            variant, start, stop = arguments[place]
            arguments[place] = Argument(fill(variant, numbers[begin:end]), start, stop)
        return tuple(arguments)

    def variants(self, numbers: Numbers) -> tuple[Variant, ...]:
        """Return the values of `arguments` without their places."""
        if not numbers:
            return self._variants
        if self._only is not None:
            before, fill, variant, after = self._only
            return (*before, fill(variant, numbers), *after)
        variants = list(self._variants)
        for place, begin, end, fill in self._plan:
            variants[place] = fill(variants[place], numbers[begin:end])
        return tuple(variants)


class _Shape:
    """Where frames of one length keep their numbers; everything else is the key of their layout."""

    __slots__ = ("find", "key", "layouts", "numbers", "spans")

    def __init__(self, length: int, spans: tuple[Number, ...]) -> None:
        fixed, numbers = ["<5s4x"], [f"<{_header_end(spans, length)}x"]
        pos = 9
        for start, code, count in spans:
            width = struct.calcsize(f"<{count}{code}")
            fixed.append(f"{start - pos}s{width}x")
            numbers.append(f"{count}{code}")
            pos = start + width
            numbers.append(f"{_next_start(spans, start, length) - pos}x")
        fixed.append(f"{length - pos}s")
        self.spans = spans
        self.key: Callable[[bytes], tuple[bytes, ...]] = struct.Struct("".join(fixed)).unpack
        self.numbers: Callable[[bytes], Numbers] = struct.Struct("".join(numbers)).unpack
        self.layouts: dict[tuple[bytes, ...], Layout] = {}
        self.find = (self.key, self.layouts.get, self.numbers)


def _header_end(spans: tuple[Number, ...], length: int) -> int:
    return spans[0].start if spans else length


def _next_start(spans: tuple[Number, ...], start: int, length: int) -> int:
    return next((span.start for span in spans if span.start > start), length)


_Finder: TypeAlias = tuple[
    Callable[[bytes], tuple[bytes, ...]],
    Callable[[tuple[bytes, ...]], Layout | None],
    Callable[[bytes], Numbers],
]
"""A shape's key, the look-up of that key, and the numbers: bound once, called for every frame."""


class _Store:
    """All layouts known, by frame length."""

    def __init__(self) -> None:
        self.shapes: dict[int, tuple[_Shape, ...]] = {}
        self.finders: dict[int, tuple[_Finder, ...]] = {}
        self.size = 0

    def add(self, raw: bytes, spans: tuple[Number, ...], prototype: tuple[Argument, ...]) -> None:
        if self.size >= MOST_LAYOUTS:
            self.shapes.clear()
            self.finders.clear()
            self.size = 0
        shapes = self.shapes.get(len(raw), ())
        shape = next((shape for shape in shapes if shape.spans == spans), None)
        if shape is None:
            shape = _Shape(len(raw), spans)
            shapes = (shape, *shapes)[:MOST_SHAPES]
            self.shapes[len(raw)] = shapes
            self.finders[len(raw)] = tuple(shape.find for shape in shapes)
        shape.layouts[shape.key(raw)] = Layout(prototype)
        self.size += 1


_STORE = _Store()
_FINDERS = _STORE.finders


def find(raw: bytes) -> tuple[Layout, Numbers] | None:
    """Return the layout of `raw` and its numbers in the order of its bytes, or None if it is not known.

    A frame whose layout is known is sound: length, EOT and every argument are as b-CAP has them.
    """
    for key, get, numbers in _FINDERS.get(len(raw), ()):
        layout = get(key(raw))
        if layout is not None:
            return layout, numbers(raw)
    return None


def learn(raw: bytes, spans: Sequence[Number], arguments: tuple[Argument, ...]) -> None:
    """Keep the form of a frame that was decoded in full and found sound.

    Args:
        raw: the frame.
        spans: where its numbers stand, in the order of its bytes.
        arguments: what it holds.
    """
    if len(raw) <= LARGEST_FRAME:
        first = arguments[0].stop if len(arguments) > 1 else 0
        _STORE.add(raw, tuple(span for span in spans if span.start >= first), arguments)


def taken_by_each(arguments: Sequence[Argument]) -> tuple[int, ...]:
    """Count the numbers that each of a frame's arguments takes; a handle before others takes none."""
    counts = [numbers_taken(argument.variant) for argument in arguments]
    return (0, *counts[1:]) if len(counts) > 1 else tuple(counts)


def numbers_taken(variant: Variant) -> int:
    """Count the numbers that a value takes from those of its frame."""
    base = variant.vt & ~ARRAY
    value = variant.value
    if base == VT.VARIANT and isinstance(value, tuple):
        return sum(numbers_taken(item) for item in value if isinstance(item, Variant))
    if base not in NUMBER_FORMATS or base == VT.BOOL:
        return 0
    if value is None:
        return 0
    if isinstance(value, bytes):
        return 1 if value else 0
    return len(value) if isinstance(value, tuple) else 1


def flatten(arguments: Sequence[Argument]) -> Numbers:
    """Take the numbers out of arguments: what `Layout.arguments` puts in."""
    taken = zip(arguments, taken_by_each(arguments), strict=True)
    return tuple(number for argument, count in taken if count for number in numbers_of(argument.variant))


def numbers_of(variant: Variant) -> Iterator[int | float | bytes]:
    """Yield the numbers of a value, in the order of its bytes."""
    value = variant.value
    if numbers_taken(variant) == 0:
        return
    if not isinstance(value, tuple):
        yield value  # type: ignore[misc]  # numbers_taken counts numbers and bytes only
    elif variant.vt == ARRAY | VT.VARIANT:
        for item in (item for item in value if isinstance(item, Variant)):
            yield from numbers_of(item)
    else:
        yield from value  # type: ignore[misc]  # the same


def _filler(variant: Variant) -> Callable[[Variant, Numbers], Variant]:
    """Return what puts just its own numbers into such a value."""
    if not isinstance(variant.value, tuple):
        return _filled_scalar
    return _filled_nest if variant.vt == ARRAY | VT.VARIANT else _filled_row


def _filled_scalar(variant: Variant, numbers: Numbers) -> Variant:
    return Variant(variant.vt, numbers[0], variant.elements)


def _filled_row(variant: Variant, numbers: Numbers) -> Variant:
    vt, _, elements = variant
    return tuple.__new__(Variant, (vt, numbers, elements))  # every set point is made here, so without a call


def _filled_nest(variant: Variant, numbers: Numbers) -> Variant:
    return _filled(variant, iter(numbers))


def _filled(variant: Variant, numbers: Iterator[int | float | bytes]) -> Variant:
    value = variant.value
    if numbers_taken(variant) == 0:
        return variant
    if not isinstance(value, tuple):
        return variant._replace(value=next(numbers))
    if variant.vt == ARRAY | VT.VARIANT:
        nested = tuple(_filled(item, numbers) for item in value if isinstance(item, Variant))
        return variant._replace(value=nested)
    return variant._replace(value=tuple(next(numbers) for _ in value))
