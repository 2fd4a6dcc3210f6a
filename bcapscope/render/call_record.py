"""Calls as JSON, one object per call."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import TypeAlias

import orjson

from bcapscope.capture.packet import PacketOrigin
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult
from bcapscope.render.frame_record import INTEGER_PLACE, JSON_PLACE, json_template
from bcapscope.render.json_values import json_text, result_object, text_fragment, time_fragment
from bcapscope.render.timestamp import epoch_text
from bcapscope.traffic.call import Call, FrameObservation
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.reserved_field import ReservedConvention

MAX_TEMPLATES = 4096  # templates in the cache; a full cache is emptied

_TemplateKey: TypeAlias = "tuple[Conversation, CallKind, TrackedObject | None, int, ReservedConvention]"

_MILLISECOND = 1_000_000
_OWN_MEMBERS = {
    "call": INTEGER_PLACE,
    "started": JSON_PLACE,
    "requests": [INTEGER_PLACE],
    "serials": [INTEGER_PLACE],
    "replies": [INTEGER_PLACE],
    "latency_ms": JSON_PLACE,
    "rtt_ms": JSON_PLACE,
}
"""JSON members that have a placeholder in the template of a call. All calls of one kind with one request and
one reply share a template, because their JSON differs only in these members.
"""


class CallRecordRenderer:
    def __init__(self) -> None:
        self._templates: dict[_TemplateKey, bytes] = {}

    def record(self, call: Call, subject: TrackedObject | None = None) -> bytes:
        """Return a call as one JSON object, without a line end. `subject` is the call's object.

        `started` is in seconds since 1970. `latency_ms` is the time from the first captured attempt to the
        reply, `rtt_ms` the time from the answered attempt to the reply. All lists except `serials` and
        `places` hold frame numbers. `places` has one object per frame if the call was captured at two places.
        """
        request, reply = call.request, call.reply
        if reply is None or not call.is_plain or isinstance(request, JoinedObservation):
            return orjson.dumps(_call_object(call, subject))
        kind = call.conversation, call.kind, subject, reply.item.code, call.convention
        form = self._templates.get(kind) or self._make_template(kind, call)
        latency = orjson.dumps(_milliseconds(call.latency))
        started = epoch_text(request.time).encode("ascii")
        serial = request.item.serial
        return form % (call.number, started, request.number, serial, reply.number, latency, latency)

    def drop_conversation(self, conversation: Conversation) -> None:
        for kind in [kind for kind in self._templates if kind[0] is conversation]:
            del self._templates[kind]

    def _make_template(self, kind: _TemplateKey, call: Call) -> bytes:
        if len(self._templates) >= MAX_TEMPLATES:
            self._templates.clear()
        self._templates[kind] = form = json_template(_call_object(call, kind[2]) | _OWN_MEMBERS)
        return form


class CallPackets:
    """Adds the member `packets` to the JSON of a call: the capture and the packet number of each frame."""

    def __init__(self, origin_of: Callable[[int], PacketOrigin | None], only_path: str | None) -> None:
        """`origin_of` takes a packet number. `only_path` is the path if there is only one capture."""
        self._origin_of = origin_of
        path = b"" if only_path is None else json_text(only_path).replace(b"%", b"%%")
        packet = b'{"frame":%d,"file":' + path + b',"packet":%d}'
        self._plain = None if only_path is None else b'%b,"packets":[' + packet + b"," + packet + b"]}"

    def add_to(self, record: bytes, call: Call) -> bytes:
        reply = call.reply
        if self._plain is not None and reply is not None and call.is_plain:  # nearly all calls
            request = call.request
            numbers = request.number, request.packet, reply.number, reply.packet
            return self._plain % (record[:-1], *numbers)
        packets = []
        for _, seen in call.frames:
            origin = self._origin_of(seen.packet)
            if origin is not None:
                packets.append(_PACKET % (seen.number, _json_path(origin.path), origin.packet))
        return b'%b,"packets":[%b]}' % (record[:-1], b",".join(packets))


_PACKET = b'{"frame":%d,"file":%b,"packet":%d}'
_json_path = lru_cache(maxsize=1024)(json_text)


def _call_object(call: Call, subject: TrackedObject | None) -> dict[str, object]:
    conversation, code = call.conversation, call.hresult
    text = {} if code is None else {"hresult_text": text_fragment(describe_hresult(code).text)}
    return {
        "call": call.number,
        "function": function_name(call.kind.function_id),
        "function_id": call.kind.function_id,
        "command": text_fragment(call.kind.command),
        "transport": conversation.transport,
        "client": text_fragment(str(conversation.client)),
        "server": text_fragment(str(conversation.server)),
        "object": text_fragment(None if subject is None else subject.label),
        "started": time_fragment(call.request.time),
        "requests": _numbers(call.attempts),
        "serials": call.serials,
        "retries": call.retries,
        "unseen_retries": call.unseen_retries,
        "replies": [] if call.reply is None else [call.reply.number],
        "late_replies": _numbers(call.late_replies),
        "lost_replies": _numbers(call.lost_replies),
        "executing": len(call.notices),
        "duplicates": _numbers(call.duplicates),
        "outcome": call.outcome,
        **result_object(code),
        **text,
        "latency_ms": _milliseconds(call.latency),
        "rtt_ms": _milliseconds(call.rtt),
        "convention": call.convention,
        "verdict": call.verdict,
        "captured_again": _numbers(call.captured_again),
        "places": [_place_object(seen) for seen in call.joined_frames],
    }


def _place_object(seen: JoinedObservation) -> dict[str, object]:
    near, far = (
        # a running proxy gives the number 0 to all frames on the controller's leg
        None if each is None else each.number or None
        for each in (seen.at_client, seen.at_controller)
    )
    return {
        "frame": seen.number,
        "client_side": near,
        "controller_side": far,
        "lost": seen.was_lost_between,
        "delay_ms": _milliseconds(seen.delay),
        "delay_error_ms": _milliseconds(seen.delay_error),
        "proxy": seen.is_relayed,
        "note": text_fragment(seen.note),
    }


def _numbers(seen: Iterable[FrameObservation]) -> list[int]:
    return [each.number for each in seen]


def _milliseconds(nanoseconds: int | None) -> float | None:
    return None if nanoseconds is None else nanoseconds / _MILLISECOND
