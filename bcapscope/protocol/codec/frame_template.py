"""Templates of frames. Similar frames share a template, so that only the first of them is decoded in full."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import TypeAlias

from bcapscope.protocol.codec.arguments import Argument, NumberSpan
from bcapscope.protocol.codec.frame_content import FrameContent, Framing
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant

FrameNumbers: TypeAlias = "tuple[int | float | bytes, ...]"
DecodedFrame: TypeAlias = "tuple[FrameTemplate, FrameNumbers] | FrameContent"

_Filler: TypeAlias = Callable[[Variant, FrameNumbers], Variant]
_SingleFill: TypeAlias = "tuple[tuple[Variant, ...], _Filler, Variant, tuple[Variant, ...]]"
"""How to fill a template if only one argument has numbers that vary. The fields are the arguments before this
argument, the function that inserts the numbers, this argument, and the arguments after it.
"""

LARGEST_TEMPLATE_FRAME = 1024
"""Size in bytes of the largest frame that gets a template. Longer frames are rare."""

MAX_TEMPLATES = 1024
"""Maximum number of templates. If there are this many, `FrameTemplates` forgets all before it learns a new
one.
"""

MAX_SHAPES_PER_LENGTH = 8
"""Maximum number of frame shapes that `FrameTemplates` keeps for one frame length."""


class _FrameShape:
    """Positions of the bytes that may vary between frames of one length: numbers, serial, reserved field."""

    def __init__(self, size: int, spans: tuple[NumberSpan, ...]) -> None:
        self.size = size
        self.spans = spans
        mask = bytearray(b"\xff" * size)
        mask[5:9] = bytes(4)
        numbers, pos = ["<"], 0
        for start, code, count in spans:
            width = struct.calcsize(f"<{count}{code}")
            mask[start : start + width] = bytes(width)
            numbers.append(f"{start - pos}x{count}{code}")
            pos = start + width
        numbers.append(f"{size - pos}x")
        self.mask = bytes(mask)
        runs = ((is_fixed, len(list(run))) for is_fixed, run in groupby(mask))
        fixed = "".join(f"{length}{'s' if is_fixed else 'x'}" for is_fixed, length in runs)
        self.fixed_parts: Callable[[bytes], tuple[bytes, ...]] = struct.Struct(fixed).unpack
        self.numbers: Callable[[bytes], FrameNumbers] = struct.Struct("".join(numbers)).unpack
        self.templates: dict[tuple[bytes, ...], FrameTemplate] = {}
        self.find_template = self.templates.get


class FrameTemplate:
    """The parts that similar frames share, learned from one valid frame, the original.

    A frame matches the template if it differs from the original only in serial, reserved field and numbers.
    The handle must be equal. Every matching frame is valid: length, EOT and arguments conform to b-CAP.

    Attributes:
        prototype: Arguments of the original frame. The numbers in `prototype` are only placeholders.
        spans: Positions of the numbers that may differ between frames.
        mask: One byte for each byte of a frame: 0 if the byte may vary between frames, 255 if not.
        fixed_parts: Function that returns the parts of a frame that all matching frames share.
        expected_parts: Result of `fixed_parts` for every frame that matches the template.
    """

    def __init__(self, shape: _FrameShape, raw: bytes, prototype: tuple[Argument, ...]) -> None:
        self.size = shape.size
        self.spans = shape.spans
        self.mask = shape.mask
        self.fixed_parts = shape.fixed_parts
        self.expected_parts = shape.fixed_parts(raw)
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
            before, variant, after = (
                self._variants[:place],
                self._variants[place],
                self._variants[place + 1 :],
            )
            self._single_fill = (before, fill, variant, after)

    @classmethod
    def learn(cls, content: FrameContent) -> FrameTemplate | None:
        """Return the template of a frame; None if the frame has problems or is not `Framing.PLAIN`."""
        if content.problems or content.framing is not Framing.PLAIN:
            return None
        shape = _FrameShape(len(content.raw), _varying_spans(content))
        return cls(shape, content.raw, content.arguments)

    def fill_arguments(self, numbers: FrameNumbers) -> tuple[Argument, ...]:
        """Return the arguments of a matching frame. `numbers` are what `FrameTemplates.decode` returned for
        this frame: the numbers that vary between frames of this template, in order.
        """
        if not numbers:
            return self.prototype
        pairs = zip(self.fill_variants(numbers), self.prototype, strict=True)
        return tuple(Argument(variant, start, stop) for variant, (_, start, stop) in pairs)

    def fill_variants(self, numbers: FrameNumbers) -> tuple[Variant, ...]:
        if not numbers:
            return self._variants
        if self._single_fill is not None:
            before, fill, variant, after = self._single_fill
            return (*before, fill(variant, numbers), *after)
        variants = list(self._variants)
        for place, begin, end, fill in self._fill_plan:
            variants[place] = fill(variants[place], numbers[begin:end])
        return tuple(variants)


class FrameTemplates:
    """Decodes frames, and learns templates from them in bounded memory, for one capture or connection."""

    def __init__(self) -> None:
        self._shapes: dict[int, tuple[_FrameShape, ...]] = {}
        self._template_count = 0
        self._recent: tuple[FrameContent, ...] = ()

    def decode(self, raw: bytes) -> DecodedFrame:
        """Return a frame's template and numbers. If the frame has problems, is longer than
        `LARGEST_TEMPLATE_FRAME`, or is not `Framing.PLAIN`, return its decoded content.
        """
        for shape in self._shapes.get(len(raw), ()):
            template = shape.find_template(shape.fixed_parts(raw))
            if template is not None:
                return template, shape.numbers(raw)
        return self._decode_in_full(raw)

    def _decode_in_full(self, raw: bytes) -> DecodedFrame:
        """Decode a frame that matches no template. Programs decode the same `raw` object several times, so
        `_recent` keeps the content of the latest two frames that got no template.
        """
        for content in self._recent:
            if content.raw is raw:
                return content
        self._recent = self._recent[:1]
        content = FrameContent(raw)
        if len(raw) <= LARGEST_TEMPLATE_FRAME and content.framing is Framing.PLAIN and not content.problems:
            return self._learn(content)
        self._recent = (content, *self._recent)
        return content

    def _learn(self, content: FrameContent) -> DecodedFrame:
        raw, spans = content.raw, _varying_spans(content)
        if self._template_count >= MAX_TEMPLATES:
            self._shapes.clear()
            self._template_count = 0
        shapes = self._shapes.get(len(raw), ())
        shape = next((shape for shape in shapes if shape.spans == spans), None)
        if shape is None:
            shape = _FrameShape(len(raw), spans)
            self._shapes[len(raw)] = (shape, *shapes)[:MAX_SHAPES_PER_LENGTH]
        template = FrameTemplate(shape, raw, content.arguments)
        shape.templates[template.expected_parts] = template
        self._template_count += 1
        return template, shape.numbers(raw)


def _varying_spans(content: FrameContent) -> tuple[NumberSpan, ...]:
    """Return the positions of the numbers that may vary between similar frames: all numbers in the arguments,
    but not in the first of several arguments, which usually is a handle.
    """
    arguments = content.arguments
    first = arguments[0].stop if len(arguments) > 1 else 0
    return tuple(span for span in content.number_spans if span.repeat and span.start >= first)


def number_counts(arguments: Sequence[Argument]) -> tuple[int, ...]:
    """Return how many numbers of each argument may vary between similar frames. For the first of several
    arguments, which usually is a handle, the count is 0.
    """
    counts = [number_count(argument.variant) for argument in arguments]
    return (0, *counts[1:]) if len(counts) > 1 else tuple(counts)


def number_count(variant: Variant) -> int:
    """Return how many numbers a value holds; a UI1 array counts as one number."""
    base = variant.vt & ~ARRAY
    value = variant.value
    if base == VT.VARIANT and isinstance(value, tuple):
        return sum(number_count(item) for item in value if isinstance(item, Variant))
    if base not in NUMBER_FORMATS or base == VT.BOOL or value is None:
        return 0
    return len(value) if isinstance(value, tuple) else int(value != b"")


def numbers_of_arguments(arguments: Sequence[Argument]) -> FrameNumbers:
    varying = arguments[1:] if len(arguments) > 1 else arguments
    return tuple(number for argument in varying for number in iter_numbers(argument.variant))


def iter_numbers(variant: Variant) -> Iterator[int | float | bytes]:
    value = variant.value
    if number_count(variant) == 0:
        return
    if not isinstance(value, tuple):
        yield value  # type: ignore[misc]  # number_count counts numbers and bytes only
    elif variant.vt == ARRAY | VT.VARIANT:
        for item in (item for item in value if isinstance(item, Variant)):
            yield from iter_numbers(item)
    else:
        yield from value  # type: ignore[misc]  # numbers and bytes only


def _filler(variant: Variant) -> Callable[[Variant, FrameNumbers], Variant]:
    if not isinstance(variant.value, tuple):
        return _fill_scalar
    return _fill_nest if variant.vt == ARRAY | VT.VARIANT else _fill_row


def _fill_scalar(variant: Variant, numbers: FrameNumbers) -> Variant:
    return Variant(variant.vt, numbers[0], variant.elements)


def _fill_row(variant: Variant, numbers: FrameNumbers) -> Variant:
    vt, _, elements = variant
    # For the number array of a set point, `tuple.__new__` is much faster than `Variant(...)`.
    return tuple.__new__(Variant, (vt, numbers, elements))


def _fill_nest(variant: Variant, numbers: FrameNumbers) -> Variant:
    return _fill_nested(variant, iter(numbers))


def _fill_nested(variant: Variant, numbers: Iterator[int | float | bytes]) -> Variant:
    value = variant.value
    if variant.vt == ARRAY | VT.VARIANT and isinstance(value, tuple):
        nested = tuple(_fill_nested(item, numbers) for item in value if isinstance(item, Variant))
        return variant._replace(value=nested)
    if number_count(variant) == 0:
        return variant
    if not isinstance(value, tuple):
        return variant._replace(value=next(numbers))
    return variant._replace(value=tuple(next(numbers) for _ in value))
