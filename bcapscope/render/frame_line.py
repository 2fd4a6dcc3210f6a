"""Frames as text, one line per frame. One template writes all frames that differ only in numeric values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, AnyStr, Generic, TypeAlias

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.codec.arguments import Argument, Problem
from bcapscope.protocol.codec.frame import Frame, Framing, Malformed
from bcapscope.protocol.codec.frame_template import (
    FrameNumbers,
    FrameTemplate,
    iter_numbers,
    number_count,
    number_counts,
    numbers_of_arguments,
)
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.protocol.tables.function_table import Param, function_name, request_param, result_param
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable, quoted
from bcapscope.render.number import (
    currency_text,
    date_text,
    number_text,
    numbers_text,
    single_text,
    singles_text,
)
from bcapscope.render.result_advice import result_text
from bcapscope.render.timestamp import TimeFormat, timestamp_writer
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Flow, Observation

FormatKey: TypeAlias = "tuple[Flow, FrameTemplate, CallKind | None]"

MAX_TEMPLATES = 4096  # templates in the cache; a full cache is emptied

MAX_RAW_BYTES = 48  # malformed bytes that a line shows


class FrameLineRenderer:
    """Writes frames as lines. Relative times count from the first line."""

    def __init__(
        self,
        time_format: TimeFormat = TimeFormat.RELATIVE,
        palette: Palette = PLAIN,
        brief: bool = False,
        write_endpoints: Callable[[Flow], str] | None = None,
        words: MessageFormatter = ENGLISH_WORDS,
    ) -> None:
        """With `brief`, lines omit problems and comments; `remarks` yields these instead. `write_endpoints`
        returns escaped text. By default, it returns addresses, transport and direction."""
        self._palette = palette
        self._write_endpoints = write_endpoints or _addresses
        self._is_brief = brief
        self._words = words
        self._write_time = timestamp_writer(time_format)
        self._templates: dict[FormatKey, PlaceholderFormat[str]] = {}

    def set_time_origin(self, time: int) -> None:
        """Count relative times from `time` (ns since 1970) instead of from the first line."""
        self._write_time(time)

    def line(
        self, observation: Observation, call_kind: CallKind | None, comments: tuple[str, ...] = ()
    ) -> str:
        if comments and not self._is_brief:
            remarks = "".join(f"  # {printable(comment)}" for comment in comments)
            return f"{self.line(observation, call_kind)}{self._palette.dim}{remarks}{self._palette.reset}"
        number, time, _, flow, item, _ = observation
        if isinstance(item, Malformed):
            return self._malformed_line(observation, item)
        found = item.template_match
        if found is None:
            head = number, self._write_time(time), item.serial, item.reserved
            return self._odd_template(flow, item, call_kind).fill(head, numbers_of_arguments(item.arguments))
        frame_template, numbers = found
        key = flow, frame_template, call_kind
        template = self._templates.get(key) or self._make_template(key, item)
        text, places = template.text, template.places
        if len(places) == 1:  # fast path for nearly all frames of a large capture: saves a function call
            where, write = places[0]
            return text % (number, self._write_time(time), item.serial, item.reserved, write(numbers[where]))
        return template.fill((number, self._write_time(time), item.serial, item.reserved), numbers)

    def remarks(self, observation: Observation, comments: tuple[str, ...]) -> Iterator[str]:
        """Yield the comments and problems that a brief line omits, one line each."""
        color = self._palette
        for comment in comments:
            yield f"{color.dim}# {printable(comment)}{color.reset}"
        for problem in observation.item.problems:
            yield f"{color.problem}!! {self._reason(problem)}{color.reset} (at {problem.offset})"

    def _reason(self, problem: Problem) -> str:
        return printable(self._words.text(problem.reason))

    def _make_template(self, key: FormatKey, frame: Frame) -> PlaceholderFormat[str]:
        if len(self._templates) >= MAX_TEMPLATES:
            self._templates.clear()
        self._templates[key] = template = self._template_builder(key[0], frame, key[2]).build()
        return template

    def _template_builder(self, flow: Flow, frame: Frame, call_kind: CallKind | None) -> LineTemplateBuilder:
        builder = LineTemplateBuilder(f"%6d %s {self._endpoints_text(flow)} %5d %5d ")
        function_id = call_kind.function_id if call_kind else None
        if flow.direction is Direction.RESPONSE:
            builder.add_text(f" {result_text(frame.code, self._palette, self._words)}")
        if call_kind is not None:
            builder.add_text(self._function(call_kind))
        role = request_param if flow.direction is Direction.REQUEST else result_param
        builder.add_arguments(frame.arguments, partial(role, function_id))
        return builder

    def _endpoints_text(self, flow: Flow) -> str:
        color = self._palette
        return f"{color.dim}{self._write_endpoints(flow)}{color.reset}".replace("%", "%%")

    def _function(self, call_kind: CallKind) -> str:
        color = self._palette
        name = f" {color.name}{function_name(call_kind.function_id)}{color.reset}"
        if call_kind.command is None:
            return name
        return f"{name} {color.name}{printable(call_kind.command[:LONGEST_STRING])}{color.reset}"

    def _odd_template(self, flow: Flow, frame: Frame, call_kind: CallKind | None) -> PlaceholderFormat[str]:
        builder = self._template_builder(flow, frame, call_kind)
        if frame.framing is not Framing.PLAIN:
            builder.add_text(f" [{frame.framing.value}]")
        if frame.problems and not self._is_brief:
            reasons = "; ".join(
                f"{self._reason(problem)} (at {problem.offset})" for problem in frame.problems
            )
            builder.add_text(f" {self._palette.problem}!! {reasons}{self._palette.reset}")
        return builder.build()

    def _malformed_line(self, observation: Observation, item: Malformed) -> str:
        reasons = "; ".join(map(self._reason, item.problems))
        shown = item.raw[:MAX_RAW_BYTES].hex(" ")
        left = len(item.raw) - MAX_RAW_BYTES
        more = f" … {self._words.plural('count.more-byte', left)}" if left > 0 else ""
        ends = self._endpoints_text(observation.flow).replace("%%", "%")
        head = f"{observation.number:>6} {self._write_time(observation.time)} {ends} {'-':>5} {'-':>5}"
        if self._is_brief:
            return f"{head}  {shown}{more}"
        problem = f"{self._palette.problem}!! {reasons}{self._palette.reset}"
        return f"{head}  {shown}{more}{' ' if shown else ''}{problem}"


def _addresses(flow: Flow) -> str:
    return printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport} {flow.direction:<8}")


LONGEST_STRING = 120
"""Maximum number of characters of a string in a line. Of a UI1 array, a line shows at most half as many
bytes as this number, because each byte takes two hexadecimal digits.
"""

MAX_ELEMENTS = 32  # elements of an array in a line

NumberWriter: TypeAlias = Callable[[Any], str]
FormatPlace: TypeAlias = tuple[int | slice, Callable[[Any], AnyStr]]
"""What to insert for one placeholder: the index or slice of a number or numbers in FrameNumbers, and the
function that writes them as text.
"""

_SHOWN_BEFORE = ("bstrCommand",)  # arguments that a line shows next to the function's name


class PlaceholderFormat(Generic[AnyStr]):
    """A %-format for a line of text or a JSON object.

    The first placeholders of the format stand for the values of `head`, in order. All further placeholders
    stand for numbers of the frame. Each of these has one element in `places`, which says which numbers to
    insert, and how to format them.
    """

    __slots__ = ("places", "text")

    def __init__(self, text: AnyStr, places: Sequence[FormatPlace[AnyStr]]) -> None:
        self.text: AnyStr = text
        self.places: tuple[FormatPlace[AnyStr], ...] = tuple(places)

    def fill(self, head: tuple[object, ...], numbers: FrameNumbers) -> AnyStr:
        if len(self.places) == 1:
            where, write = self.places[0]
            return self.text % (*head, write(numbers[where]))
        return self.text % (*head, *[write(numbers[where]) for where, write in self.places])


class LineTemplateBuilder:
    def __init__(self, head: str = "") -> None:
        """`head` is a %-format."""
        self._pieces = [head]
        self._places: list[FormatPlace[str]] = []
        self._numbers_placed = 0

    def add_text(self, text: str) -> None:
        self._pieces.append(text.replace("%", "%%"))

    def add_arguments(self, arguments: Sequence[Argument], role: Callable[[int], Param]) -> None:
        """Add arguments as ``name=value``. Show types that differ from the function's definition."""
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

    def build(self) -> PlaceholderFormat[str]:
        return PlaceholderFormat("".join(self._pieces), self._places)

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
            self.add_text(VT(base).name if base in VT.__members__.values() else vt_name(base))
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
                self.add_text(_string_text(value) if isinstance(value, str) else str(bool(value)).lower())
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


def _string_text(text: str) -> str:
    if len(text) <= LONGEST_STRING:
        return quoted(text)
    return f"{quoted(text[:LONGEST_STRING])}… {len(text) - LONGEST_STRING} more"


def _bytes_text(data: bytes) -> str:
    most = LONGEST_STRING // 2
    more = f"… {len(data) - most} more" if len(data) > most else ""
    return data[:most].hex() + more


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
