"""How the filter language reads frames and calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.question import Question


class Told(NamedTuple):
    """An observation, and what is known about it.

    Attributes:
        seen: the observation.
        question: what it asks or answers, where that was seen.
        comments: that the capture has on it.
    """

    seen: Observation
    question: Question | None
    comments: tuple[str, ...] = ()


_Read: TypeAlias = Callable[[Told], object]


def _kind(told: Told) -> str:
    return str(told.seen.flow.direction) if isinstance(told.seen.item, Frame) else "malformed"


def _of_frame(read: Callable[[Frame], object]) -> _Read:
    return lambda told: read(told.seen.item) if isinstance(told.seen.item, Frame) else None


def _length(told: Told) -> int:
    item = told.seen.item
    return item.length if isinstance(item, Frame) else len(item.raw)


def _hresult(told: Told) -> int | None:
    item = told.seen.item
    answers = isinstance(item, Frame) and told.seen.flow.direction is Direction.RESPONSE
    return item.code if answers and isinstance(item, Frame) else None


def _of_hresult(read: Callable[[int], object]) -> _Read:
    def get(told: Told) -> object:
        code = _hresult(told)
        return None if code is None else read(code)

    return get


def _of_question(read: Callable[[Question], object]) -> _Read:
    return lambda told: None if told.question is None else read(told.question)


FRAME_GETTERS: Mapping[str, Callable[[Told], object]] = {
    "frame": lambda told: told.seen.number,
    "packet": lambda told: told.seen.packet,
    "time": lambda told: told.seen.time,
    "src": lambda told: told.seen.flow.src,
    "dst": lambda told: told.seen.flow.dst,
    "client": lambda told: told.seen.flow.conversation.client,
    "server": lambda told: told.seen.flow.conversation.server,
    "transport": lambda told: told.seen.flow.conversation.transport,
    "kind": _kind,
    "length": _length,
    "serial": _of_frame(lambda frame: frame.serial),
    "reserved": _of_frame(lambda frame: frame.reserved),
    "function_id": _of_question(lambda question: question.function_id),
    "function": _of_question(lambda question: function_name(question.function_id)),
    "command": _of_question(lambda question: question.command),
    "arg": _of_frame(lambda frame: frame.arguments),
    "hresult": _hresult,
    "hresult_name": _of_hresult(hresult_name),
    "hresult_text": _of_hresult(lambda code: describe(code).text),
    "problems": lambda told: [problem.reason for problem in told.seen.item.problems],
}
"""A getter for each field of a frame."""


def _result_name(call: Exchange) -> str | None:
    return None if call.hresult is None else hresult_name(call.hresult)


def _result_text(call: Exchange) -> str | None:
    return None if call.hresult is None else describe(call.hresult).text


CALL_GETTERS: Mapping[str, Callable[[Exchange], object]] = {
    "call": lambda call: call.call,
    "client": lambda call: call.conversation.client,
    "server": lambda call: call.conversation.server,
    "transport": lambda call: call.conversation.transport,
    "function_id": lambda call: call.question.function_id,
    "function": lambda call: function_name(call.question.function_id),
    "command": lambda call: call.question.command,
    "arg": lambda call: call.request.item.arguments,
    "hresult": lambda call: call.hresult,
    "hresult_name": _result_name,
    "hresult_text": _result_text,
    "started": lambda call: call.request.time,
    "requests": lambda call: [seen.number for seen in call.requests],
    "serials": lambda call: call.serials,
    "retries": lambda call: call.retries,
    "replies": lambda call: [] if call.reply is None else [call.reply.number],
    "late_replies": lambda call: [seen.number for seen in call.late_replies],
    "lost_replies": lambda call: [seen.number for seen in call.lost_replies],
    "executing": lambda call: len(call.notices),
    "duplicates": lambda call: [seen.number for seen in call.duplicates],
    "outcome": lambda call: call.outcome,
    "latency": lambda call: call.latency,
    "rtt": lambda call: call.rtt,
    "convention": lambda call: call.convention,
    "verdict": lambda call: call.verdict,
}
"""A getter for each field of a call."""
