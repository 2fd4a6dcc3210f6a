"""Templates: what frames of one form share, so that a million of them need only one full decoding.

Robot traffic is repetitive. Two set points of a slave-mode session differ only in serial, reserved and the
numbers inside their arguments. If a frame has several arguments, the first is a handle. Handles take few
values, so the handle is part of the template.

A `FrameTemplate` holds what stays the same. It comes from the first frame that was decoded in full and found
sound. A later frame that matches it byte for byte outside the varying positions needs only its numbers
unpacked.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from bcapscope.protocol.codec.arguments import Argument, NumberSpan
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant

FrameNumbers: TypeAlias = "tuple[int | float | bytes, ...]"

_Filler: TypeAlias = Callable[[Variant, FrameNumbers], Variant]
_SingleFill: TypeAlias = "tuple[tuple[Variant, ...], _Filler, Variant, tuple[Variant, ...]]"
"""For the only argument with numbers: the values before it, its filler, its prototype, and the values after
it."""

LARGEST_TEMPLATE_FRAME = 1024
"""Largest frame that gets a template, in bytes. Longer frames are decoded one by one: they are rare, and
keeping their bytes would cost more."""

MAX_TEMPLATES = 1024
"""Maximum number of templates. When it is reached, all are dropped and learnt again."""

MAX_SHAPES_PER_LENGTH = 8
"""Maximum number of shapes tried for one frame length."""


class FrameTemplate:
    """The constant part of frames of one form.

    Attributes:
        prototype: Arguments of the frame that it was learnt from; their numbers are placeholders.
    """

    __slots__ = ("_fill_plan", "_single_fill", "_variants", "prototype")

    def __init__(self, prototype: tuple[Argument, ...]) -> None:
        self.prototype = prototype
        self._variants = tuple(argument.variant for argument in prototype)
        self._fill_plan: list[tuple[int, int, int, _Filler]] = []
        self._single_fill: _SingleFill | None = None
        begin = 0
        for place, taken in enumerate(number_counts(prototype)):
            if taken:
                self._fill_plan.append((place, begin, begin + taken, _filler(prototype[place].variant)))
                begin += taken
        if len(self._fill_plan) == 1:
            place, _, _, fill = self._fill_plan[0]
            self._single_fill = (
                self._variants[:place],
                fill,
                self._variants[place],
                self._variants[place + 1 :],
            )

    def fill_arguments(self, numbers: FrameNumbers) -> tuple[Argument, ...]:
        """Return the arguments with a frame's own `numbers`, which are in the order of its bytes."""
        if not numbers:
            return self.prototype
        arguments = list(self.prototype)
        for place, begin, end, fill in self._fill_plan:
            variant, start, stop = arguments[place]
            arguments[place] = Argument(fill(variant, numbers[begin:end]), start, stop)
        return tuple(arguments)

    def fill_variants(self, numbers: FrameNumbers) -> tuple[Variant, ...]:
        """Return the values of `fill_arguments` without their positions."""
        if not numbers:
            return self._variants
        if self._single_fill is not None:
            before, fill, variant, after = self._single_fill
            return (*before, fill(variant, numbers), *after)
        variants = list(self._variants)
        for place, begin, end, fill in self._fill_plan:
            variants[place] = fill(variants[place], numbers[begin:end])
        return tuple(variants)


_FixedParts: TypeAlias = Callable[[bytes], "tuple[bytes, ...]"]


class FrameForm:
    """Recognises the frames that differ from a sound frame only in serial, reserved and numbers.

    Such a frame is sound as well, and has the same code. This is the cheapest check: it decodes nothing.

    Attributes:
        size: Size of the frames in bytes.
        fixed_parts: Returns the bytes of a frame of this size that do not differ.
        expected_parts: These bytes.
    """

    __slots__ = ("expected_parts", "fixed_parts", "size")

    def __init__(self, raw: bytes, spans: Sequence[NumberSpan]) -> None:
        """Learn from a sound frame.

        Args:
            raw: The bytes of the frame.
            spans: Positions of the numbers that may differ.
        """
        self.size = len(raw)
        self.fixed_parts = _fixed_parts(len(raw), spans)
        self.expected_parts = self.fixed_parts(raw)

    def matches(self, raw: bytes) -> bool:
        """Return whether a frame differs only in serial, reserved and numbers."""
        return len(raw) == self.size and self.fixed_parts(raw) == self.expected_parts


def _fixed_parts(length: int, spans: Sequence[NumberSpan]) -> _FixedParts:
    """Return a function that takes the bytes of a frame apart, without serial, reserved and numbers."""
    parts, pos = ["<5s4x"], 9
    for start, code, count in spans:
        width = struct.calcsize(f"<{count}{code}")
        parts.append(f"{start - pos}s{width}x")
        pos = start + width
    parts.append(f"{length - pos}s")
    return struct.Struct("".join(parts)).unpack


def fixed_bytes(length: int, spans: Sequence[NumberSpan]) -> bytes:
    """Return a mask of a frame's bytes: 0 for serial, reserved and the numbers in `spans`, otherwise 255."""
    fixed = bytearray(b"\xff" * length)
    fixed[5:9] = bytes(4)
    for start, code, count in spans:
        width = struct.calcsize(f"<{count}{code}")
        fixed[start : start + width] = bytes(width)
    return bytes(fixed)


def varying_spans(spans: Sequence[NumberSpan], arguments: Sequence[Argument]) -> tuple[NumberSpan, ...]:
    """Return the positions of the numbers that vary among frames of one form: all but those of a handle."""
    first = arguments[0].stop if len(arguments) > 1 else 0
    return tuple(span for span in spans if span.repeat and span.start >= first)


class _Shape:
    """Positions of the numbers in frames of one length; all other bytes are the key of a template."""

    __slots__ = ("finder", "key", "spans", "templates", "unpack_numbers")

    def __init__(self, length: int, spans: tuple[NumberSpan, ...]) -> None:
        numbers = [f"<{_header_end(spans, length)}x"]
        for start, code, count in spans:
            stop = start + struct.calcsize(f"<{count}{code}")
            numbers.append(f"{count}{code}{_next_start(spans, start, length) - stop}x")
        self.spans = spans
        self.key = _fixed_parts(length, spans)
        self.unpack_numbers: Callable[[bytes], FrameNumbers] = struct.Struct("".join(numbers)).unpack
        self.templates: dict[tuple[bytes, ...], FrameTemplate] = {}
        self.finder = (self.key, self.templates.get, self.unpack_numbers)


def _header_end(spans: tuple[NumberSpan, ...], length: int) -> int:
    return spans[0].start if spans else length


def _next_start(spans: tuple[NumberSpan, ...], start: int, length: int) -> int:
    return next((span.start for span in spans if span.start > start), length)


_Finder: TypeAlias = tuple[
    Callable[[bytes], tuple[bytes, ...]],
    Callable[[tuple[bytes, ...]], FrameTemplate | None],
    Callable[[bytes], FrameNumbers],
]
"""A shape's key function, template look-up and number unpacker: bound once, called for every frame."""


class _TemplateStore:
    """All known templates, by frame length."""

    def __init__(self) -> None:
        self.shapes: dict[int, tuple[_Shape, ...]] = {}
        self.finders: dict[int, tuple[_Finder, ...]] = {}
        self.template_count = 0

    def add(self, raw: bytes, spans: tuple[NumberSpan, ...], prototype: tuple[Argument, ...]) -> None:
        if self.template_count >= MAX_TEMPLATES:
            self.shapes.clear()
            self.finders.clear()
            self.template_count = 0
        shapes = self.shapes.get(len(raw), ())
        shape = next((shape for shape in shapes if shape.spans == spans), None)
        if shape is None:
            shape = _Shape(len(raw), spans)
            shapes = (shape, *shapes)[:MAX_SHAPES_PER_LENGTH]
            self.shapes[len(raw)] = shapes
            self.finders[len(raw)] = tuple(shape.finder for shape in shapes)
        shape.templates[shape.key(raw)] = FrameTemplate(prototype)
        self.template_count += 1


_STORE = _TemplateStore()
_FINDERS = _STORE.finders


def find_template(raw: bytes) -> tuple[FrameTemplate, FrameNumbers] | None:
    """Return the template of `raw` and its numbers in the order of its bytes; None if there is no template.

    A frame that matches a template is sound: length, EOT and every argument conform to b-CAP.
    """
    for key, get, numbers in _FINDERS.get(len(raw), ()):
        layout = get(key(raw))
        if layout is not None:
            return layout, numbers(raw)
    return None


def learn_template(raw: bytes, spans: Sequence[NumberSpan], arguments: tuple[Argument, ...]) -> None:
    """Store a template of a frame that was decoded in full and found sound.

    Frames longer than `LARGEST_TEMPLATE_FRAME` are ignored.

    Args:
        raw: The bytes of the frame.
        spans: Positions of its numbers, in the order of its bytes.
        arguments: Its decoded arguments.
    """
    if len(raw) <= LARGEST_TEMPLATE_FRAME:
        _STORE.add(raw, varying_spans(spans, arguments), arguments)


def number_counts(arguments: Sequence[Argument]) -> tuple[int, ...]:
    """Return how many numbers each argument of a frame holds; a handle before other arguments counts as 0."""
    counts = [number_count(argument.variant) for argument in arguments]
    return (0, *counts[1:]) if len(counts) > 1 else tuple(counts)


def number_count(variant: Variant) -> int:
    """Return how many numbers of its frame a value holds; the bytes of a UI1 array count as one."""
    base = variant.vt & ~ARRAY
    value = variant.value
    if base == VT.VARIANT and isinstance(value, tuple):
        return sum(number_count(item) for item in value if isinstance(item, Variant))
    if base not in NUMBER_FORMATS or base == VT.BOOL:
        return 0
    if value is None:
        return 0
    if isinstance(value, bytes):
        return 1 if value else 0
    return len(value) if isinstance(value, tuple) else 1


def numbers_of_arguments(arguments: Sequence[Argument]) -> FrameNumbers:
    """Return the numbers of arguments, as `FrameTemplate.fill_arguments` expects them."""
    taken = zip(arguments, number_counts(arguments), strict=True)
    return tuple(number for argument, count in taken if count for number in iter_numbers(argument.variant))


def iter_numbers(variant: Variant) -> Iterator[int | float | bytes]:
    """Yield the numbers of a value, in the order of its bytes."""
    value = variant.value
    if number_count(variant) == 0:
        return
    if not isinstance(value, tuple):
        yield value  # type: ignore[misc]  # number_count counts numbers and bytes only
    elif variant.vt == ARRAY | VT.VARIANT:
        for item in (item for item in value if isinstance(item, Variant)):
            yield from iter_numbers(item)
    else:
        yield from value  # type: ignore[misc]  # the same


def _filler(variant: Variant) -> Callable[[Variant, FrameNumbers], Variant]:
    """Return the function that puts numbers into a value of this form."""
    if not isinstance(variant.value, tuple):
        return _fill_scalar
    return _fill_nest if variant.vt == ARRAY | VT.VARIANT else _fill_row


def _fill_scalar(variant: Variant, numbers: FrameNumbers) -> Variant:
    return Variant(variant.vt, numbers[0], variant.elements)


def _fill_row(variant: Variant, numbers: FrameNumbers) -> Variant:
    vt, _, elements = variant
    return tuple.__new__(Variant, (vt, numbers, elements))  # hot path of set points: avoids Variant.__new__


def _fill_nest(variant: Variant, numbers: FrameNumbers) -> Variant:
    return _fill_nested(variant, iter(numbers))


def _fill_nested(variant: Variant, numbers: Iterator[int | float | bytes]) -> Variant:
    value = variant.value
    if number_count(variant) == 0:
        return variant
    if not isinstance(value, tuple):
        return variant._replace(value=next(numbers))
    if variant.vt == ARRAY | VT.VARIANT:
        nested = tuple(_fill_nested(item, numbers) for item in value if isinstance(item, Variant))
        return variant._replace(value=nested)
    return variant._replace(value=tuple(next(numbers) for _ in value))
