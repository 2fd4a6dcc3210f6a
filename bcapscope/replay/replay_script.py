"""A recorded session as a script: who said what, when, and what was answered."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation


class ScriptCall(NamedTuple):
    """One call, without its retries.

    Attributes:
        number: its number in the recording.
        kind: function and command.
        arguments: of the request.
        offset: when it was asked first, ns after the first call of the script.
        hresult: of the accepted reply; None where there was none.
        values: of that reply.
        duration: ns from the request that was answered to that reply; 0 where there was none.
        notice_offsets: when S_EXECUTING came, ns after the first request.
    """

    number: int
    kind: CallKind
    arguments: tuple[Variant, ...]
    offset: int
    hresult: int | None
    values: tuple[Variant, ...]
    duration: int
    notice_offsets: tuple[int, ...]


class ReplayScript(NamedTuple):
    """All calls of one client, in the order in which they were asked.

    Attributes:
        conversation: between whom.
        calls: one at least.
        reply_reserved: what the server's replies carry in reserved.
    """

    conversation: Conversation
    calls: tuple[ScriptCall, ...]
    reply_reserved: ReplyReserved


def scripts_of(calls: Iterable[Call]) -> tuple[ReplayScript, ...]:
    """Sort calls by their clients; who made most comes first.

    A call whose request is damaged is left out.
    """
    by_client: dict[Conversation, list[Call]] = {}
    for call in calls:
        if not call.request.item.problems:
            by_client.setdefault(call.conversation, []).append(call)
    scripts = [_script(conversation, found) for conversation, found in by_client.items()]
    return tuple(sorted(scripts, key=lambda script: -len(script.calls)))


def _script(conversation: Conversation, calls: list[Call]) -> ReplayScript:
    calls = sorted(calls, key=lambda call: call.request.time)
    start = calls[0].request.time
    return ReplayScript(
        conversation, tuple(_script_call(call, start) for call in calls), calls[-1].reply_reserved
    )


def _script_call(call: Call, start: int) -> ScriptCall:
    reply, asked = call.reply, call.request.time
    return ScriptCall(
        number=call.number,
        kind=call.kind,
        arguments=_values(call.request.item),
        offset=asked - start,
        hresult=call.hresult,
        values=() if reply is None else _values(reply.item),
        duration=call.rtt or 0,
        notice_offsets=tuple(notice.time - asked for notice in call.notices),
    )


def _values(frame: Frame) -> tuple[Variant, ...]:
    return frame.variants
