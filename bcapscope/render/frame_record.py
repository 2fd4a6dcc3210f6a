"""Frames as JSON, one object per frame.

Frames that differ only in their numbers share a template: JSON with placeholders for the numbers. A JSON
encoder escapes all text from the wire.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import orjson

from bcapscope.capture.capture_sequence import PacketOrigin
from bcapscope.protocol.codec.arguments import Argument, Problem
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.codec.frame_template import (
    FrameNumbers,
    FrameTemplate,
    iter_numbers,
    number_counts,
    numbers_of_arguments,
)
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.protocol.tables.function_table import Param, function_name, request_param, result_param
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.json_values import json_number, json_text
from bcapscope.render.number import currency_text, date_text
from bcapscope.render.timestamp import epoch_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Flow, Observation

MAX_TEMPLATES = 4096
"""Maximum number of cached templates. When the cache is full, the renderer empties it."""


NumberPlace: TypeAlias = "tuple[int | slice, Callable[[object], bytes]]"


class _RecordTemplate:
    """The JSON object of a frame, encoded as bytes. The object has placeholders for the frame's numbers,
    because these numbers differ between similar frames.
    """

    __slots__ = ("_parts", "_text")

    def __init__(self, text: bytes, parts: Sequence[NumberPlace]) -> None:
        self._text = text
        self._parts = tuple(parts)

    def fill(self, head: tuple[object, ...], numbers: FrameNumbers) -> bytes:
        parts = self._parts
        if len(parts) == 1:
            where, write = parts[0]
            return self._text % (*head, write(numbers[where]))
        return self._text % (*head, *[write(numbers[where]) for where, write in parts])


class _RecordTemplateBuilder:
    """Builds a template by appending parts."""

    def __init__(self, head: bytes = b"") -> None:
        self._pieces = [head]
        self._parts: list[NumberPlace] = []
        self._numbers_placed = 0

    def add_text(self, text: bytes) -> None:
        self._pieces.append(text.replace(b"%", b"%%"))

    def add_arguments(self, arguments: Sequence[Argument], role: Callable[[int], Param]) -> None:
        self.add_text(b"[")
        for index, (argument, taken) in enumerate(zip(arguments, number_counts(arguments), strict=True)):
            self.add_text(b',{"name":' if index else b'{"name":')
            self.add_text(json_text(role(index).name) + b",")
            if taken:
                self._add_typed(argument.variant)
            else:
                self._add_constant(argument.variant)
            self.add_text(b"}")
        self.add_text(b"]")

    def _add_constant(self, variant: Variant) -> None:
        """Add a value that is the same in all frames that share the template."""
        builder = _RecordTemplateBuilder()
        builder._add_typed(variant)
        self.add_text(builder.build().fill((), tuple(iter_numbers(variant))))

    def build(self) -> _RecordTemplate:
        return _RecordTemplate(b"".join(self._pieces), self._parts)

    def _add_typed(self, variant: Variant) -> None:
        base = variant.vt & ~ARRAY
        self.add_text(b'"type":' + json_text(vt_name(variant.vt)) + b',"value":')
        if base in NUMBER_FORMATS and base != VT.BOOL and variant.value not in (None, b""):
            self._add_numbers(base, variant)
        elif variant.vt == ARRAY | VT.VARIANT and isinstance(variant.value, tuple):
            self._add_variants(variant.value)
        else:
            self.add_text(_constant(variant.value))

    def _add_numbers(self, base: int, variant: Variant) -> None:
        value = variant.value
        where: int | slice = self._numbers_placed
        if isinstance(value, tuple):
            where = slice(self._numbers_placed, self._numbers_placed + len(value))
        self._numbers_placed += len(value) if isinstance(value, tuple) else 1
        self._add_place(where, _bytes_list if isinstance(value, bytes) else json_number)
        beside = _EXTRA_MEMBERS.get(base)
        if beside is not None:
            self.add_text(b',"' + beside[0] + b'":')
            self._add_place(where, partial(_converted, beside[1]))

    def _add_place(self, where: int | slice, write: Callable[[object], bytes]) -> None:
        self._pieces.append(b"%b")
        self._parts.append((where, write))

    def _add_variants(self, values: tuple[object, ...]) -> None:
        self.add_text(b"[")
        for index, item in enumerate(values):
            self.add_text(b",{" if index else b"{")
            if isinstance(item, Variant):
                self._add_typed(item)
            self.add_text(b"}")
        self.add_text(b"]")


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


def _converted(convert: Callable[[object], str], value: object) -> bytes:
    if isinstance(value, tuple):
        return orjson.dumps([convert(item) for item in value])
    return orjson.dumps(convert(value))


_EXTRA_MEMBERS: dict[int, tuple[bytes, Callable[[object], str]]] = {
    VT.CY: (b"scaled", lambda raw: currency_text(raw) if isinstance(raw, int) else ""),
    VT.DATE: (b"date", lambda days: date_text(days) if isinstance(days, float) else ""),
}


class FrameRecordRenderer:
    """Writes frames as JSON objects."""

    def __init__(self) -> None:
        self._templates: dict[tuple[Flow, FrameTemplate, CallKind | None], _RecordTemplate] = {}

    def record(
        self, observation: Observation, call_kind: CallKind | None, comments: tuple[str, ...] = ()
    ) -> bytes:
        """Return a frame or malformed bytes as one JSON object, without a line end."""
        if comments:
            return b'%b,"comments":[%b]}' % (
                self.record(observation, call_kind)[:-1],
                b",".join(map(json_text, comments)),
            )
        number, time, _, flow, item, packet = observation
        if isinstance(item, Malformed):
            return self._malformed_record(observation, item)
        head = number, epoch_text(time).encode("ascii"), packet, item.length, item.serial, item.reserved
        found = item.template_match
        if found is None:
            return _make_record_template(flow, item, call_kind, item.problems).fill(
                head, numbers_of_arguments(item.arguments)
            )
        key = flow, found[0], call_kind
        form = self._templates.get(key) or self._make_template(key, item)
        return form.fill(head, found[1])

    def _make_template(
        self, key: tuple[Flow, FrameTemplate, CallKind | None], frame: Frame
    ) -> _RecordTemplate:
        if len(self._templates) >= MAX_TEMPLATES:
            self._templates.clear()
        self._templates[key] = form = _make_record_template(key[0], frame, key[2], ())
        return form

    def _malformed_record(self, observation: Observation, item: Malformed) -> bytes:
        builder = _RecordTemplateBuilder(_template_head(observation.flow, b"malformed", b"null", b"null"))
        builder.add_text(
            b'"function_id":null,"function":null,"command":null,"hresult":null,"hresult_name":null,'
        )
        builder.add_text(b'"args":[],"problems":' + _problems(item.problems) + _raw(item.raw))
        builder.add_text((b',"missing":%d' % item.missing if item.missing else b"") + b"}")
        moment = epoch_text(observation.time).encode("ascii")
        return builder.build().fill((observation.number, moment, observation.packet, len(item.raw)), ())


def with_origin(record: bytes, origin: PacketOrigin) -> bytes:
    """Add the capture, and the number of the packet in this capture, to a frame as JSON."""
    return b'%b,"file":%b,"file_packet":%d}' % (record[:-1], json_text(origin.path), origin.packet)


def _template_head(flow: Flow, kind: bytes, serial: bytes = b"%d", reserved: bytes = b"%d") -> bytes:
    """Return a template for the first JSON members of a frame, with placeholders for their numbers."""
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


def _make_record_template(
    flow: Flow, frame: Frame, call_kind: CallKind | None, problems: tuple[Problem, ...]
) -> _RecordTemplate:
    builder = _RecordTemplateBuilder(_template_head(flow, flow.direction.encode("ascii")))
    function_id = call_kind.function_id if call_kind else None
    name = None if function_id is None else function_name(function_id)
    builder.add_text(b'"function_id":%b,"function":%b,' % (orjson.dumps(function_id), json_text(name)))
    builder.add_text(b'"command":%b,' % json_text(call_kind.command if call_kind else None))
    if flow.direction is Direction.REQUEST:
        builder.add_text(b'"hresult":null,"hresult_name":null,"args":')
        builder.add_arguments(frame.arguments, partial(request_param, function_id))
    else:
        code = (frame.code, json_text(hresult_name(frame.code)), json_text(describe_hresult(frame.code).text))
        builder.add_text(b'"hresult":%d,"hresult_name":%b,"hresult_text":%b,"args":' % code)
        builder.add_arguments(frame.arguments, partial(result_param, function_id))
    builder.add_text(b',"problems":' + _problems(problems))
    builder.add_text((_raw(frame.raw) if problems else b"") + b"}")
    return builder.build()


def _problems(problems: tuple[Problem, ...]) -> bytes:
    return orjson.dumps([{**problem._asdict(), "reason": str(problem.reason)} for problem in problems])


def _raw(raw: bytes) -> bytes:
    return b',"raw":"%b"' % raw.hex().encode("ascii")
