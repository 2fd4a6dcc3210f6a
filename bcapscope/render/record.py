"""One JSON object a frame, for programs.

What frames of one layout have in common is written once as bytes with places for numbers; nothing that
comes from the wire gets into the output but through a JSON encoder.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import orjson

from bcapscope.protocol.arguments import Argument, Problem
from bcapscope.protocol.frame import Frame, Malformed
from bcapscope.protocol.functions import Param, function_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.protocol.layout import Layout, Numbers, flatten, numbers_of, taken_by_each
from bcapscope.protocol.roles import request_role, result_role
from bcapscope.protocol.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.render.moment import epoch_text
from bcapscope.render.number import cy_text, date_text
from bcapscope.traffic.observation import Direction, Flow, Observation
from bcapscope.traffic.question import Question

MOST_FORMS = 4096
"""Forms and flow texts kept; when there are more, all are forgotten and made again."""


Part: TypeAlias = "tuple[int | slice, Callable[[object], bytes]]"


def json_text(value: str | None) -> bytes:
    """Write a string as JSON in which every character that is not plainly visible is escaped.

    A lone surrogate comes out as its escape, which JSON allows, so that nothing is lost.
    """
    if value is None:
        return b"null"
    if value.isprintable():
        return orjson.dumps(value)
    return json.dumps(value).replace("\x7f", "\\u007f").encode("ascii")


def json_number(value: object) -> bytes:
    """Write a number, or a tuple of numbers; NaN and infinities become strings."""
    text = orjson.dumps(value)
    return text if b"null" not in text else orjson.dumps(_spelled(value))


def _spelled(value: object) -> object:
    if isinstance(value, tuple):
        return [_spelled(item) for item in value]
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


class _Form:
    """Bytes with places for numbers."""

    __slots__ = ("_parts", "_text")

    def __init__(self, text: bytes, parts: Sequence[Part]) -> None:
        self._text = text
        self._parts = tuple(parts)

    def fill(self, head: tuple[object, ...], numbers: Numbers) -> bytes:
        parts = self._parts
        if len(parts) == 1:
            where, write = parts[0]
            return self._text % (*head, write(numbers[where]))
        return self._text % (*head, *[write(numbers[where]) for where, write in parts])


class _FormBuilder:
    """Collects a form, left to right; `taken` counts the numbers that have their places."""

    def __init__(self, head: bytes = b"") -> None:
        self._pieces = [head]
        self._parts: list[Part] = []
        self._taken = 0

    def put(self, text: bytes) -> None:
        self._pieces.append(text.replace(b"%", b"%%"))

    def arguments(self, arguments: Sequence[Argument], role: Callable[[int], Param]) -> None:
        self.put(b"[")
        for index, (argument, taken) in enumerate(zip(arguments, taken_by_each(arguments), strict=True)):
            self.put(b',{"name":' if index else b'{"name":')
            self.put(json_text(role(index).name) + b",")
            if taken:
                self._typed(argument.variant)
            else:
                self._settled(argument.variant)
            self.put(b"}")
        self.put(b"]")

    def _settled(self, variant: Variant) -> None:
        """Add a value whose numbers are the same in all frames of the layout."""
        builder = _FormBuilder()
        builder._typed(variant)
        self.put(builder.done().fill((), tuple(numbers_of(variant))))

    def done(self) -> _Form:
        return _Form(b"".join(self._pieces), self._parts)

    def _typed(self, variant: Variant) -> None:
        base = variant.vt & ~ARRAY
        self.put(b'"type":' + json_text(vt_name(variant.vt)) + b',"value":')
        if base in NUMBER_FORMATS and base != VT.BOOL and variant.value not in (None, b""):
            self._numbers(base, variant)
        elif variant.vt == ARRAY | VT.VARIANT and isinstance(variant.value, tuple):
            self._variants(variant.value)
        else:
            self.put(_constant(variant.value))

    def _numbers(self, base: int, variant: Variant) -> None:
        value = variant.value
        where: int | slice = self._taken
        if isinstance(value, tuple):
            where = slice(self._taken, self._taken + len(value))
        self._taken += len(value) if isinstance(value, tuple) else 1
        self._place(where, _bytes_list if isinstance(value, bytes) else json_number)
        beside = _BESIDE.get(base)
        if beside is not None:
            self.put(b',"' + beside[0] + b'":')
            self._place(where, partial(_each, beside[1]))

    def _place(self, where: int | slice, write: Callable[[object], bytes]) -> None:
        self._pieces.append(b"%b")
        self._parts.append((where, write))

    def _variants(self, values: tuple[object, ...]) -> None:
        self.put(b"[")
        for index, item in enumerate(values):
            self.put(b",{" if index else b"{")
            if isinstance(item, Variant):
                self._typed(item)
            self.put(b"}")
        self.put(b"]")


def _constant(value: object) -> bytes:
    if isinstance(value, str):
        return json_text(value)
    if isinstance(value, bytes):
        return _bytes_list(value)
    if isinstance(value, tuple):
        return b"[" + b",".join(map(_constant, value)) + b"]"
    return orjson.dumps(value)


def _bytes_list(value: object) -> bytes:
    return orjson.dumps(list(value) if isinstance(value, bytes) else [])


def _each(convert: Callable[[object], str], value: object) -> bytes:
    if isinstance(value, tuple):
        return orjson.dumps([convert(item) for item in value])
    return orjson.dumps(convert(value))


_BESIDE: dict[int, tuple[bytes, Callable[[object], str]]] = {
    VT.CY: (b"scaled", lambda raw: cy_text(raw) if isinstance(raw, int) else ""),
    VT.DATE: (b"date", lambda days: date_text(days) if isinstance(days, float) else ""),
}


class RecordRenderer:
    """Writes frames as JSON objects."""

    def __init__(self) -> None:
        self._forms: dict[tuple[Flow, Layout, Question | None], _Form] = {}

    def record(self, seen: Observation, question: Question | None, comments: tuple[str, ...] = ()) -> bytes:
        """Write one object, without a line end.

        Args:
            seen: the frame or malformed bytes.
            question: what a request asks, or a reply answers where that was seen.
            comments: that the capture has on it.
        """
        if comments:
            return b'%b,"comments":[%b]}' % (
                self.record(seen, question)[:-1],
                b",".join(map(json_text, comments)),
            )
        number, time, _, flow, item, packet = seen
        if isinstance(item, Malformed):
            return self._malformed(seen, item)
        head = number, epoch_text(time).encode("ascii"), packet, item.length, item.serial, item.reserved
        found = item.layout
        if found is None:
            return _form(flow, item, question, item.problems).fill(head, flatten(item.arguments))
        key = flow, found[0], question
        form = self._forms.get(key) or self._remember(key, item)
        return form.fill(head, found[1])

    def _remember(self, key: tuple[Flow, Layout, Question | None], frame: Frame) -> _Form:
        if len(self._forms) >= MOST_FORMS:
            self._forms.clear()
        self._forms[key] = form = _form(key[0], frame, key[2], ())
        return form

    def _malformed(self, seen: Observation, item: Malformed) -> bytes:
        builder = _FormBuilder(_head(seen.flow, b"malformed", b"null", b"null"))
        builder.put(b'"function_id":null,"function":null,"command":null,"hresult":null,"hresult_name":null,')
        builder.put(b'"args":[],"problems":' + _problems(item.problems) + _raw(item.raw))
        builder.put((b',"missing":%d' % item.missing if item.missing else b"") + b"}")
        moment = epoch_text(seen.time).encode("ascii")
        return builder.done().fill((seen.number, moment, seen.packet, len(item.raw)), ())


def _head(flow: Flow, kind: bytes, serial: bytes = b"%d", reserved: bytes = b"%d") -> bytes:
    """Begin an object with what every frame has; the places are for number, time, packet and length."""
    names = (b"src", b"dst", b"transport")
    texts = (flow.src_text, flow.dst_text, flow.conversation.transport)
    ends = b"".join(b'"%b":%b,' % (name, json_text(text)) for name, text in zip(names, texts, strict=True))
    return b"".join(
        (
            b'{"frame":%d,"time":%b,"packet":%d,',
            ends.replace(b"%", b"%%"),
            b'"kind":"' + kind + b'","length":%d,"serial":' + serial + b',"reserved":' + reserved + b",",
        )
    )


def _form(flow: Flow, frame: Frame, question: Question | None, problems: tuple[Problem, ...]) -> _Form:
    builder = _FormBuilder(_head(flow, flow.direction.encode("ascii")))
    function_id = question.function_id if question else None
    name = None if function_id is None else function_name(function_id)
    builder.put(b'"function_id":%b,"function":%b,' % (orjson.dumps(function_id), json_text(name)))
    builder.put(b'"command":%b,' % json_text(question.command if question else None))
    if flow.direction is Direction.REQUEST:
        builder.put(b'"hresult":null,"hresult_name":null,"args":')
        builder.arguments(frame.arguments, partial(request_role, function_id))
    else:
        code = (frame.code, json_text(hresult_name(frame.code)), json_text(describe(frame.code).text))
        builder.put(b'"hresult":%d,"hresult_name":%b,"hresult_text":%b,"args":' % code)
        builder.arguments(frame.arguments, partial(result_role, function_id))
    builder.put(b',"problems":' + _problems(problems))
    builder.put((_raw(frame.raw) if problems else b"") + b"}")
    return builder.done()


def _problems(problems: tuple[Problem, ...]) -> bytes:
    return orjson.dumps([problem._asdict() for problem in problems])


def _raw(raw: bytes) -> bytes:
    return b',"raw":"%b"' % raw.hex().encode("ascii")
