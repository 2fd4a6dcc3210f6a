"""What is known of a call in trouble without a search."""

from __future__ import annotations

from bcapscope.traffic.call import Call, FrameRole
from bcapscope.traffic.frame_index import FrameIndex
from tests.traffic.playbook import MOVE, POSE, S_EXECUTING, Script, calls_of


def trouble() -> Call:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, MOVE)
    client.ask(2, 2, 1, MOVE)
    client.reply(3, 1, 0, 0, POSE)
    client.reply(4, 2, 0, S_EXECUTING)
    client.ask(5, 2, 1, MOVE)
    client.reply(6, 2, 0, 0, POSE)
    (call,) = calls_of(script.track())
    return call


def test_a_call_that_is_under_way_is_known_at_once() -> None:
    call = trouble()
    heard = FrameIndex(call)
    first, second = call.attempts
    assert heard.sent_at == {first.item.raw: first.time, second.item.raw: second.time}
    assert heard.reserved_by_serial == {1: 1, 2: 1}
    assert call.reply is not None
    late = call.late_replies[0]
    assert heard.received_at == {late.item.raw: late.time, call.reply.item.raw: call.reply.time}


def test_a_try_is_known_by_when_it_was_seen_last() -> None:
    call = trouble()
    heard = FrameIndex(call)
    (copy,) = call.duplicates
    heard.add_frame(FrameRole.RETRY, copy)
    assert heard.sent_at[copy.item.raw] == copy.time
