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
from bcapscope.protocol.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.render.moment import epoch_text
from bcapscope.render.phrase import cy_text, date_text
from bcapscope.render.roles import request_role, result_role
from bcapscope.traffic.observation import Direction, Flow, Observation
from bcapscope.traffic.question import Question, question_of

MOST_FORMS = 4096
"""Forms and flow texts kept; when there are more, all are forgotten and made again."""

_HEAD = b'{"frame":%d,"time":%b,%b"length":%d,"serial":%d,"reserved":%d,%b,"packet":%d}'

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

    def fill(self, numbers: Numbers) -> bytes:
        parts = self._parts
        if len(parts) == 1:
            where, write = parts[0]
            return self._text % write(numbers[where])
        return self._text % tuple([write(numbers[where]) for where, write in parts])


class _FormBuilder:
    """Collects a form, left to right; `taken` counts the numbers that have their places."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
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
        self.put(builder.done().fill(tuple(numbers_of(variant))))

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


_REQUEST = Direction.REQUEST


class RecordRenderer:
    """Writes frames as JSON objects."""

    def __init__(self) -> None:
        self._forms: dict[tuple[Layout, Question | None, bool], _Form] = {}
        self._flows: dict[Flow, bytes] = {}

    def record(self, seen: Observation, question: Question | None) -> bytes:
        """Write one object, without a line end.

        Args:
            seen: the frame or malformed bytes.
            question: for a reply, the request that it answers, where that was seen.
        """
        number, time, _, flow, item, packet = seen
        if isinstance(item, Malformed):
            return self._malformed(seen, item)
        found = item.layout
        if found is None:
            asks = flow.direction is _REQUEST
            tail = _form(item, question, asks, item.problems).fill(flatten(item.arguments))
        else:
            key = (found[0], question, flow.direction is _REQUEST)
            form = self._forms.get(key) or self._remember(key, item)
            tail = form.fill(found[1])
        ends = self._flows.get(flow) or self._remember_flow(flow)
        moment = epoch_text(time).encode("ascii")
        return _HEAD % (number, moment, ends, item.length, item.serial, item.reserved, tail, packet)

    def _remember(self, key: tuple[Layout, Question | None, bool], frame: Frame) -> _Form:
        if len(self._forms) >= MOST_FORMS:
            self._forms.clear()
        self._forms[key] = form = _form(frame, key[1], key[2], ())
        return form

    def _remember_flow(self, flow: Flow) -> bytes:
        if len(self._flows) >= MOST_FORMS:
            self._flows.clear()
        self._flows[flow] = text = _ends(flow) + b'"kind":' + json_text(flow.direction) + b","
        return text

    def _malformed(self, seen: Observation, item: Malformed) -> bytes:
        head = b'{"frame":%d,"time":%b,' % (seen.number, epoch_text(seen.time).encode("ascii"))
        body = b'"kind":"malformed","length":%d,"serial":null,"reserved":null,' % len(item.raw)
        missing = b',"missing":%d' % item.missing if item.missing else b""
        return (
            head
            + _ends(seen.flow)
            + body
            + _NOTHING
            + b'"args":[],"problems":'
            + _problems(item.problems)
            + _raw(item.raw)
            + missing
            + b',"packet":%d}' % seen.packet
        )


_NOTHING = b'"function_id":null,"function":null,"command":null,"hresult":null,"hresult_name":null,'


def _ends(flow: Flow) -> bytes:
    names = (b"src", b"dst", b"transport")
    texts = (flow.src_text, flow.dst_text, flow.conversation.transport)
    return b"".join(b'"%b":%b,' % (name, json_text(text)) for name, text in zip(names, texts, strict=True))


def _form(frame: Frame, question: Question | None, asks: bool, problems: tuple[Problem, ...]) -> _Form:
    builder = _FormBuilder()
    asked = question_of(frame) if asks else question
    function_id = asked.function_id if asked else None
    builder.put(b'"function_id":%b,' % orjson.dumps(function_id))
    builder.put(
        b'"function":%b,' % json_text(function_name(function_id) if function_id is not None else None)
    )
    builder.put(b'"command":%b,' % json_text(asked.command if asked else None))
    if asks:
        builder.put(b'"hresult":null,"hresult_name":null,"args":')
        builder.arguments(frame.arguments, partial(request_role, function_id))
    else:
        code = (frame.code, json_text(hresult_name(frame.code)), json_text(describe(frame.code).text))
        builder.put(b'"hresult":%d,"hresult_name":%b,"hresult_text":%b,"args":' % code)
        builder.arguments(frame.arguments, partial(result_role, function_id))
    builder.put(b',"problems":' + _problems(problems))
    if problems:
        builder.put(_raw(frame.raw))
    return builder.done()


def _problems(problems: tuple[Problem, ...]) -> bytes:
    return orjson.dumps([problem._asdict() for problem in problems])


def _raw(raw: bytes) -> bytes:
    return b',"raw":"%b"' % raw.hex().encode("ascii")
