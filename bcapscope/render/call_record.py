"""One JSON object a call, for programs."""

from __future__ import annotations

import orjson

from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.render.moment import epoch_text
from bcapscope.render.record import json_text
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.handles import Thing
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question
from bcapscope.traffic.verdict import Outcome, Verdict

MOST_TEXTS = 4096
"""Beginnings and results that are kept ready made; when there are more, all are made again."""

_MILLISECOND = 1_000_000
_OBJECT = (
    b'{"call":%d,%b"object":%b,"started":%b,"requests":%b,"serials":%b,"retries":%d,"replies":%b,"late_replies":%b,'
    b'"executing":%d,"duplicates":%b,"outcome":"%b",%b,"latency_ms":%b,"rtt_ms":%b,"convention":"%b",'
    b'"verdict":"%b"}'
)
_OUTCOMES = {outcome: outcome.value.encode("ascii") for outcome in Outcome}
_VERDICTS = {verdict: verdict.value.encode("ascii") for verdict in Verdict}


class CallRecordRenderer:
    """Writes calls as JSON objects."""

    def __init__(self) -> None:
        self._heads: dict[tuple[Conversation, Question], bytes] = {}
        self._results: dict[int | None, bytes] = {}

    def record(self, call: Exchange, subject: Thing | None = None) -> bytes:
        """Write one object, without a line end; `object` is the name of `subject`, of which it was asked.

        `started` is in seconds since 1970, `latency_ms` runs from the first request to the accepted reply,
        `rtt_ms` from the request that it answers; lists hold frame numbers but for `serials`.
        """
        key = call.conversation, call.question
        head = self._heads.get(key) or self._remember(key)
        result = self._results.get(call.hresult) or self._remember_result(call.hresult)
        latency = _duration(call.latency)
        reply = b"[]" if call.reply is None else b"[%d]" % call.reply.number
        started = epoch_text(call.request.time).encode("ascii")
        outcome, verdict = _OUTCOMES[call.outcome], _VERDICTS[call.verdict]
        convention = call.convention.encode("ascii")
        if call.is_plain:
            request = call.request
            requests, serials, rtt = b"[%d]" % request.number, b"[%d]" % request.item.serial, latency
            retries, executing, late, duplicates = 0, 0, b"[]", b"[]"
        else:
            requests = orjson.dumps([seen.number for seen in call.requests])
            serials, retries, executing = orjson.dumps(call.serials), call.retries, len(call.notices)
            late = orjson.dumps([seen.number for seen in (*call.late_replies, *call.lost_replies)])
            duplicates = orjson.dumps([seen.number for seen in call.duplicates])
            rtt = _duration(call.rtt)
        return _OBJECT % (
            call.call,
            head,
            b"null" if subject is None else json_text(subject.label),
            started,
            requests,
            serials,
            retries,
            reply,
            late,
            executing,
            duplicates,
            outcome,
            result,
            latency,
            rtt,
            convention,
            verdict,
        )

    def _remember(self, key: tuple[Conversation, Question]) -> bytes:
        if len(self._heads) >= MOST_TEXTS:
            self._heads.clear()
        conversation, question = key
        values = {
            b"function": json_text(function_name(question.function_id)),
            b"function_id": orjson.dumps(question.function_id),
            b"command": json_text(question.command),
            b"transport": json_text(conversation.transport),
            b"client": json_text(str(conversation.client)),
            b"server": json_text(str(conversation.server)),
        }
        text = b"".join(b'"%b":%b,' % item for item in values.items())
        self._heads[key] = text
        return text

    def _remember_result(self, code: int | None) -> bytes:
        if len(self._results) >= MOST_TEXTS:
            self._results.clear()
        if code is None:
            text = b'"hresult":null,"hresult_name":null'
        else:
            meaning = (code, json_text(hresult_name(code)), json_text(describe(code).text))
            text = b'"hresult":%d,"hresult_name":%b,"hresult_text":%b' % meaning
        self._results[code] = text
        return text


def _duration(nanoseconds: int | None) -> bytes:
    return b"null" if nanoseconds is None else orjson.dumps(nanoseconds / _MILLISECOND)
