"""A recorded session as a script: who said what, when, and what was answered."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.protocol.convention import ReplyReserved
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question


class Line(NamedTuple):
    """One call, without its retries.

    Attributes:
        call: its number in the recording.
        question: function and command.
        arguments: of the request.
        at: when it was asked first, ns after the first call of the script.
        hresult: of the accepted reply; None where there was none.
        values: of that reply.
        took: ns from the request that was answered to that reply; 0 where there was none.
        notices: when S_EXECUTING came, ns after the first request.
    """

    call: int
    question: Question
    arguments: tuple[Variant, ...]
    at: int
    hresult: int | None
    values: tuple[Variant, ...]
    took: int
    notices: tuple[int, ...]


class Script(NamedTuple):
    """All calls of one client, in the order in which they were asked.

    Attributes:
        conversation: between whom.
        lines: one at least.
        replies: what the server's replies carry in reserved.
    """

    conversation: Conversation
    lines: tuple[Line, ...]
    replies: ReplyReserved


def scripts_of(calls: Iterable[Exchange]) -> tuple[Script, ...]:
    """Sort calls by their clients; who made most comes first.

    A call whose request is damaged is left out.
    """
    by_client: dict[Conversation, list[Exchange]] = {}
    for call in calls:
        if not call.request.item.problems:
            by_client.setdefault(call.conversation, []).append(call)
    scripts = [_script(conversation, found) for conversation, found in by_client.items()]
    return tuple(sorted(scripts, key=lambda script: -len(script.lines)))


def _script(conversation: Conversation, calls: list[Exchange]) -> Script:
    calls = sorted(calls, key=lambda call: call.request.time)
    start = calls[0].request.time
    return Script(conversation, tuple(_line(call, start) for call in calls), calls[-1].reply_reserved)


def _line(call: Exchange, start: int) -> Line:
    reply, asked = call.reply, call.request.time
    return Line(
        call=call.call,
        question=call.question,
        arguments=_values(call.request.item),
        at=asked - start,
        hresult=call.hresult,
        values=() if reply is None else _values(reply.item),
        took=call.rtt or 0,
        notices=tuple(notice.time - asked for notice in call.notices),
    )


def _values(frame: Frame) -> tuple[Variant, ...]:
    return frame.variants
