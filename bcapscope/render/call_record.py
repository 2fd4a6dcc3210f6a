"""One JSON object a call, for programs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import orjson

from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.json_values import json_text
from bcapscope.render.timestamp import epoch_text
from bcapscope.traffic.call import Call, FrameObservation
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.reserved_field import ReservedConvention

MAX_TEMPLATES = 4096
"""Forms of plain answered calls that are kept ready made; when there are more, all are made again."""

_TemplateKey: TypeAlias = "tuple[Conversation, CallKind, TrackedObject | None, int, ReservedConvention]"

_MILLISECOND = 1_000_000
_OBJECT = (
    b'{"call":%b,%b"object":%b,"started":%b,"requests":%b,"serials":%b,"retries":%b,"replies":%b,'
    b'"late_replies":%b,"lost_replies":%b,"executing":%b,"duplicates":%b,"outcome":"%b",%b,'
    b'"latency_ms":%b,"rtt_ms":%b,"convention":"%b","verdict":"%b"}'
)
_OUTCOMES = {outcome: outcome.value.encode("ascii") for outcome in Outcome}
_VERDICTS = {verdict: verdict.value.encode("ascii") for verdict in CallVerdict}


class CallRecordRenderer:
    """Writes calls as JSON objects."""

    def __init__(self) -> None:
        self._templates: dict[_TemplateKey, bytes] = {}

    def record(self, call: Call, subject: TrackedObject | None = None) -> bytes:
        """Write one object, without a line end; `object` is the name of `subject`, of which it was asked.

        `started` is in seconds since 1970, `latency_ms` runs from the first request to the accepted reply,
        `rtt_ms` from the request that it answers; lists hold frame numbers but for `serials`.
        """
        request, reply = call.request, call.reply
        if reply is None or not call.is_plain:
            return _full_record(call, subject)
        kind = call.conversation, call.kind, subject, reply.item.code, call.convention
        form = self._templates.get(kind) or self._make_template(kind, call)
        latency = _duration(call.latency)
        started = epoch_text(request.time).encode("ascii")
        serial = request.item.serial
        return form % (call.number, started, request.number, serial, reply.number, latency, latency)

    def drop_conversation(self, conversation: Conversation) -> None:
        """Forget a conversation that is over."""
        for kind in [kind for kind in self._templates if kind[0] is conversation]:
            del self._templates[kind]

    def _make_template(self, kind: _TemplateKey, call: Call) -> bytes:
        """Make the form of plain answered calls of one kind, with places for what is their own."""
        if len(self._templates) >= MAX_TEMPLATES:
            self._templates.clear()
        head, thing, result = _head(call), _object(kind[2]), _result(call)
        self._templates[kind] = form = _OBJECT % (
            b"%d",
            head.replace(b"%", b"%%"),
            thing.replace(b"%", b"%%"),
            b"%b",
            b"[%d]",
            b"[%d]",
            b"0",
            b"[%d]",
            b"[]",
            b"[]",
            b"0",
            b"[]",
            _OUTCOMES[call.outcome],
            result.replace(b"%", b"%%"),
            b"%b",
            b"%b",
            call.convention.encode("ascii"),
            _VERDICTS[call.verdict],
        )
        return form


def _full_record(call: Call, subject: TrackedObject | None) -> bytes:
    """Write a call to which anything may have happened."""
    return _OBJECT % (
        b"%d" % call.number,
        _head(call),
        _object(subject),
        epoch_text(call.request.time).encode("ascii"),
        _numbers(call.attempts),
        orjson.dumps(call.serials),
        b"%d" % call.retries,
        b"[]" if call.reply is None else b"[%d]" % call.reply.number,
        _numbers(call.late_replies),
        _numbers(call.lost_replies),
        b"%d" % len(call.notices),
        _numbers(call.duplicates),
        _OUTCOMES[call.outcome],
        _result(call),
        _duration(call.latency),
        _duration(call.rtt),
        call.convention.encode("ascii"),
        _VERDICTS[call.verdict],
    )


def _head(call: Call) -> bytes:
    conversation, question = call.conversation, call.kind
    values = {
        b"function": json_text(function_name(question.function_id)),
        b"function_id": orjson.dumps(question.function_id),
        b"command": json_text(question.command),
        b"transport": json_text(conversation.transport),
        b"client": json_text(str(conversation.client)),
        b"server": json_text(str(conversation.server)),
    }
    return b"".join(b'"%b":%b,' % item for item in values.items())


def _object(subject: TrackedObject | None) -> bytes:
    return b"null" if subject is None else json_text(subject.label)


def _result(call: Call) -> bytes:
    code = call.hresult
    if code is None:
        return b'"hresult":null,"hresult_name":null'
    meaning = (code, json_text(hresult_name(code)), json_text(describe_hresult(code).text))
    return b'"hresult":%d,"hresult_name":%b,"hresult_text":%b' % meaning


def _numbers(seen: Iterable[FrameObservation]) -> bytes:
    return orjson.dumps([each.number for each in seen])


def _duration(nanoseconds: int | None) -> bytes:
    return b"null" if nanoseconds is None else orjson.dumps(nanoseconds / _MILLISECOND)
