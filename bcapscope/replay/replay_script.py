"""A recorded session as a script: the calls of one client, with their times, arguments and results."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation


class ScriptCall(NamedTuple):
    """One recorded call, without its retries. Times are in ns.

    Attributes:
        offset: Time from the first call of the script to the first attempt of this call.
        duration: Time from the answered attempt to the reply; 0 if no reply was captured.
        notice_offsets: For each notice (S_EXECUTING), the time from the first attempt to the notice.
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
    """The recorded calls of one client, at least one, in the order of their first attempts.

    `reply_reserved` says how the recorded controller fills the reserved field of its replies.
    """

    conversation: Conversation
    calls: tuple[ScriptCall, ...]
    reply_reserved: ReplyReserved


def scripts_of(calls: Iterable[Call]) -> tuple[ReplayScript, ...]:
    """Return one script per client, the longest first. Leave out calls whose request is damaged."""
    by_client: dict[Conversation, list[Call]] = {}
    for call in calls:
        if not call.request.item.problems:
            by_client.setdefault(call.conversation, []).append(call)
    scripts = []
    for conversation, found in by_client.items():
        found.sort(key=lambda call: call.request.time)
        lines = tuple(_script_call(call, found[0].request.time) for call in found)
        scripts.append(ReplayScript(conversation, lines, found[-1].reply_reserved))
    return tuple(sorted(scripts, key=lambda script: -len(script.calls)))


def _script_call(call: Call, start: int) -> ScriptCall:
    reply, asked = call.reply, call.request.time
    return ScriptCall(
        number=call.number,
        kind=call.kind,
        arguments=call.request.item.variants,
        offset=asked - start,
        hresult=call.hresult,
        values=() if reply is None else reply.item.variants,
        duration=call.rtt or 0,
        notice_offsets=tuple(notice.time - asked for notice in call.notices),
    )
