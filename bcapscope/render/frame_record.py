"""Frames as JSON, one object per frame. One template writes all frames that differ only in numeric values."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import orjson

from bcapscope.capture.packet import PacketOrigin
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.codec.frame_template import (
    FrameNumbers,
    iter_numbers,
    number_counts,
    numbers_of_arguments,
)
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant, vt_name
from bcapscope.protocol.tables.function_table import function_name, request_param, result_param
from bcapscope.protocol.tables.hresult import describe_hresult
from bcapscope.render.frame_line import FormatKey, FormatPlace, PlaceholderFormat
from bcapscope.render.json_values import json_number, json_text, result_object, text_fragment, time_fragment
from bcapscope.render.number import currency_text, date_text
from bcapscope.render.timestamp import epoch_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Flow, Observation

MAX_TEMPLATES = 4096  # templates in the cache; a full cache is emptied


JSON_PLACE, INTEGER_PLACE = orjson.Fragment(b"\0"), orjson.Fragment(b"\1")
"""Placeholders in a template. A JSON encoder escapes these control characters in texts."""


def json_template(members: dict[str, object]) -> bytes:
    """Return JSON as a %-format. ``%d`` replaces `INTEGER_PLACE`, and ``%b`` replaces `JSON_PLACE`."""
    return orjson.dumps(members).replace(b"%", b"%%").replace(b"\1", b"%d").replace(b"\0", b"%b")


class _ArgumentConverter:
    """Converts arguments to JSON types. `places` collects the placeholders."""

    def __init__(self, constants: FrameNumbers | None = None) -> None:
        """If `constants` is given, the JSON contains the numbers in `constants` instead of placeholders."""
        self.places: list[FormatPlace[bytes]] = []
        self._constants = constants
        self._numbers_placed = 0

    def members(self, variant: Variant) -> dict[str, object]:
        vt, value = variant.vt, variant.value
        base = vt & ~ARRAY
        found: dict[str, object] = {"type": text_fragment(vt_name(vt))}
        if base in NUMBER_FORMATS and base != VT.BOOL and value not in (None, b""):
            where: int | slice = self._numbers_placed
            if isinstance(value, tuple):
                where = slice(self._numbers_placed, self._numbers_placed + len(value))
            self._numbers_placed += len(value) if isinstance(value, tuple) else 1
            found["value"] = self._number(where, _bytes_list if isinstance(value, bytes) else json_number)
            if base in _EXTRA_MEMBERS:
                name, convert = _EXTRA_MEMBERS[base]
                found[name] = self._number(where, partial(_converted, convert))
        elif vt == ARRAY | VT.VARIANT and isinstance(value, tuple):
            found["value"] = [self.members(item) if isinstance(item, Variant) else {} for item in value]
        else:
            found["value"] = _without_numbers(value)
        return found

    def _number(self, where: int | slice, write: Callable[[Any], bytes]) -> orjson.Fragment:
        if self._constants is not None:
            return orjson.Fragment(write(self._constants[where]))
        self.places.append((where, write))
        return JSON_PLACE


def _without_numbers(value: object) -> object:
    if isinstance(value, str):
        return text_fragment(value)
    if isinstance(value, bytes):
        return orjson.Fragment(_bytes_list(value))
    return list(map(_without_numbers, value)) if isinstance(value, tuple) else value


def _bytes_list(value: bytes) -> bytes:
    return orjson.dumps(list(value))


def _converted(convert: Callable[[Any], str], value: object) -> bytes:
    return orjson.dumps(list(map(convert, value)) if isinstance(value, tuple) else convert(value))


_EXTRA_MEMBERS: dict[int, tuple[str, Callable[[Any], str]]] = {
    VT.CY: ("scaled", currency_text),
    VT.DATE: ("date", date_text),
}


class FrameRecordRenderer:
    def __init__(self) -> None:
        self._templates: dict[FormatKey, PlaceholderFormat[bytes]] = {}

    def record(
        self, observation: Observation, call_kind: CallKind | None, comments: tuple[str, ...] = ()
    ) -> bytes:
        if comments:
            return b'%b,"comments":[%b]}' % (
                self.record(observation, call_kind)[:-1],
                b",".join(map(json_text, comments)),
            )
        number, time, _, flow, item, packet = observation
        if isinstance(item, Malformed):
            return _malformed_record(observation, item)
        head = number, epoch_text(time).encode("ascii"), packet, item.length, item.serial, item.reserved
        found = item.template_match
        if found is None:
            return _make_record_template(flow, item, call_kind, item.problems).fill(
                head, numbers_of_arguments(item.arguments)
            )
        key = flow, found[0], call_kind
        form = self._templates.get(key) or self._make_template(key, item)
        return form.fill(head, found[1])

    def _make_template(self, key: FormatKey, frame: Frame) -> PlaceholderFormat[bytes]:
        if len(self._templates) >= MAX_TEMPLATES:
            self._templates.clear()
        self._templates[key] = form = _make_record_template(key[0], frame, key[2], ())
        return form


def with_origin(record: bytes, origin: PacketOrigin) -> bytes:
    """Add the path of the capture, and the packet number in this capture, to the JSON of a frame."""
    return b'%b,"file":%b,"file_packet":%d}' % (record[:-1], json_text(origin.path), origin.packet)


def _malformed_record(observation: Observation, item: Malformed) -> bytes:
    head = {
        "frame": observation.number,
        "time": time_fragment(observation.time),
        "packet": observation.packet,
        **_ends(observation.flow),
        "kind": "malformed",
        "length": len(item.raw),
    }
    nothing = ("serial", "reserved", "function_id", "function", "command", "hresult", "hresult_name")
    missing = {"missing": item.missing} if item.missing else {}
    tail = {"args": [], **_problem_members(item.problems), "raw": item.raw.hex(), **missing}
    return orjson.dumps({**head, **dict.fromkeys(nothing), **tail})


def _ends(flow: Flow) -> dict[str, object]:
    return {
        "src": text_fragment(flow.src_text),
        "dst": text_fragment(flow.dst_text),
        "transport": flow.conversation.transport,
    }


def _make_record_template(
    flow: Flow, frame: Frame, call_kind: CallKind | None, problems: tuple[Problem, ...]
) -> PlaceholderFormat[bytes]:
    function_id = call_kind.function_id if call_kind else None
    is_request = flow.direction is Direction.REQUEST
    code = None if is_request else frame.code
    role, converter, arguments = request_param if is_request else result_param, _ArgumentConverter(), []
    for index, (argument, taken) in enumerate(
        zip(frame.arguments, number_counts(frame.arguments), strict=True)
    ):
        variant = argument.variant
        # `taken` counts the numbers of the argument that may differ between the frames of this template. If
        # `taken` is 0, the argument has the same value in all these frames.
        used = converter if taken else _ArgumentConverter(tuple(iter_numbers(variant)))
        arguments.append({"name": text_fragment(role(function_id, index).name), **used.members(variant)})
    members = {
        "frame": INTEGER_PLACE,
        "time": JSON_PLACE,
        "packet": INTEGER_PLACE,
        **_ends(flow),
        "kind": flow.direction,
        "length": INTEGER_PLACE,
        "serial": INTEGER_PLACE,
        "reserved": INTEGER_PLACE,
        "function_id": function_id,
        "function": None if function_id is None else function_name(function_id),
        "command": text_fragment(call_kind.command if call_kind else None),
        **result_object(code),
        **({} if code is None else {"hresult_text": text_fragment(describe_hresult(code).text)}),
        "args": arguments,
        **_problem_members(problems),
        **({"raw": frame.raw.hex()} if problems else {}),
    }
    return PlaceholderFormat(json_template(members), converter.places)


def _problem_members(problems: tuple[Problem, ...]) -> dict[str, object]:
    return {"problems": [{**problem._asdict(), "reason": str(problem.reason)} for problem in problems]}
