"""Functions that read the fields of the filter syntax from frames and calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Endpoint, Observation


class AnnotatedFrame(NamedTuple):
    """An observation, and the kind of call that it belongs to.

    Attributes:
        call_kind: Function and command of the request, or of the request that a reply answers; None if
            unknown.
    """

    observation: Observation
    call_kind: CallKind | None
    comments: tuple[str, ...] = ()


_Read: TypeAlias = Callable[[AnnotatedFrame], object]


def _kind(annotated: AnnotatedFrame) -> str:
    return (
        str(annotated.observation.flow.direction)
        if isinstance(annotated.observation.item, Frame)
        else "malformed"
    )


def _of_frame(read: Callable[[Frame], object]) -> _Read:
    return lambda told: read(told.observation.item) if isinstance(told.observation.item, Frame) else None


def _length(annotated: AnnotatedFrame) -> int:
    item = annotated.observation.item
    return item.length if isinstance(item, Frame) else len(item.raw)


def _hresult(annotated: AnnotatedFrame) -> int | None:
    item = annotated.observation.item
    answers = isinstance(item, Frame) and annotated.observation.flow.direction is Direction.RESPONSE
    return item.code if answers and isinstance(item, Frame) else None


def _of_hresult(read: Callable[[int], object]) -> _Read:
    def get(told: AnnotatedFrame) -> object:
        code = _hresult(told)
        return None if code is None else read(code)

    return get


def _of_call_kind(read: Callable[[CallKind], object]) -> _Read:
    return lambda told: None if told.call_kind is None else read(told.call_kind)


FRAME_GETTERS: Mapping[str, Callable[[AnnotatedFrame], object]] = {
    "frame": lambda told: told.observation.number,
    "packet": lambda told: told.observation.packet,
    "time": lambda told: told.observation.time,
    "src": lambda told: told.observation.flow.src,
    "dst": lambda told: told.observation.flow.dst,
    "client": lambda told: told.observation.flow.conversation.client,
    "server": lambda told: told.observation.flow.conversation.server,
    "transport": lambda told: told.observation.flow.conversation.transport,
    "kind": _kind,
    "length": _length,
    "serial": _of_frame(lambda frame: frame.serial),
    "reserved": _of_frame(lambda frame: frame.reserved),
    "function_id": _of_call_kind(lambda question: question.function_id),
    "function": _of_call_kind(lambda question: function_name(question.function_id)),
    "command": _of_call_kind(lambda question: question.command),
    "arg": _of_frame(lambda frame: frame.arguments),
    "hresult": _hresult,
    "hresult_name": _of_hresult(hresult_name),
    "hresult_text": _of_hresult(lambda code: describe_hresult(code).text),
    "problems": lambda frame: [str(problem.reason) for problem in frame.observation.item.problems],
}
"""Getter of each frame field, by name."""


def _clients(call: Call) -> Endpoint | tuple[Endpoint, Endpoint]:
    """Return the client; for a call that was captured on both legs of a proxy, the client of each leg."""
    near, far = call.conversation, call.conversation.controller_leg
    return near.client if far is None else (near.client, far.client)


def _servers(call: Call) -> Endpoint | tuple[Endpoint, Endpoint]:
    near, far = call.conversation, call.conversation.controller_leg
    return near.server if far is None else (near.server, far.server)


def _result_name(call: Call) -> str | None:
    return None if call.hresult is None else hresult_name(call.hresult)


def _result_text(call: Call) -> str | None:
    return None if call.hresult is None else describe_hresult(call.hresult).text


CALL_GETTERS: Mapping[str, Callable[[Call], object]] = {
    "call": lambda call: call.number,
    "client": _clients,
    "server": _servers,
    "transport": lambda call: call.conversation.transport,
    "function_id": lambda call: call.kind.function_id,
    "function": lambda call: function_name(call.kind.function_id),
    "command": lambda call: call.kind.command,
    "arg": lambda call: call.request.item.arguments,
    "hresult": lambda call: call.hresult,
    "hresult_name": _result_name,
    "hresult_text": _result_text,
    "started": lambda call: call.request.time,
    "requests": lambda call: [seen.number for seen in call.attempts],
    "serials": lambda call: call.serials,
    "retries": lambda call: call.retries,
    "unseen_retries": lambda call: call.unseen_retries,
    "replies": lambda call: [] if call.reply is None else [call.reply.number],
    "late_replies": lambda call: [seen.number for seen in call.late_replies],
    "lost_replies": lambda call: [seen.number for seen in call.lost_replies],
    "executing": lambda call: len(call.notices),
    "duplicates": lambda call: [seen.number for seen in call.duplicates],
    "captured_again": lambda call: [seen.number for seen in call.captured_again],
    "outcome": lambda call: call.outcome,
    "latency": lambda call: call.latency,
    "rtt": lambda call: call.rtt,
    "convention": lambda call: call.convention,
    "verdict": lambda call: call.verdict,
}
"""Getter of each call field, by name."""
