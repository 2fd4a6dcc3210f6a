"""What a call tells about itself."""

from __future__ import annotations

import pytest

from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedConvention
from tests.traffic.playbook import (
    EXECUTE,
    MOVE,
    MS,
    POSE,
    START_SERVICE,
    Script,
    calls_of,
    execute,
    play,
)


def test_the_retry_story_of_2009_is_one_call() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1232, 0, MOVE)
    client.ask(2, 1233, 1232, MOVE)
    client.ask(4, 1234, 1232, MOVE)
    client.ask(6, 1235, 1232, MOVE)
    client.reply(6.5, 1233, 1232, 0, POSE)
    client.reply(7.2, 1235, 1232, 0, POSE)
    (call,) = calls_of(script.track())
    assert call.serials == (1232, 1233, 1234, 1235)
    assert call.retries == 3
    assert [reply.number for reply in call.late_replies] == [5]
    assert call.reply is not None
    assert call.reply.number == 6
    assert (call.outcome, call.verdict) == (Outcome.ANSWERED, CallVerdict.REPLY_LATE)
    assert (call.convention, call.reply_reserved) == (ReservedConvention.SEED, ReplyReserved.ECHOED)
    assert (call.latency, call.rtt) == (7_200_000, 1_200_000)
    assert call.kind == CallKind(EXECUTE, "slvMove")
    assert call.hresult == 0


def test_calls_without_trouble() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, START_SERVICE)
    client.reply(1, 1)
    client.ask(8, 2, 2, MOVE)
    client.reply(9.5, 2, 0, 0x83500121)
    first, second = calls_of(script.track())
    assert (first.number, first.verdict, first.latency, first.rtt) == (1, CallVerdict.ANSWERED, MS, MS)
    assert (second.outcome, second.verdict) == (Outcome.REFUSED, CallVerdict.REFUSED)
    assert second.hresult == 0x83500121
    assert first.late_replies == first.lost_replies == first.notices == first.duplicates == ()
    assert repr(first) == "Call(1, 1, None: request 1, reply 2)"


@pytest.mark.parametrize(
    ("replies", "received"),
    [
        pytest.param([(9.0, 1, 0)], True, id="answered"),
        pytest.param([(9.0, 1, S_EXECUTING)], True, id="noticed"),
        pytest.param([(9.0, 1, 0), (9.5, 2, 0)], True, id="late"),
        pytest.param([], False, id="unanswered"),
    ],
)
def test_a_reply_shows_that_the_controller_received_the_call(
    replies: list[tuple[float, int, int]], received: bool
) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(8, 2, 1, MOVE)
    for time, serial, code in replies:
        client.reply(time, serial, 0, code)
    (call,) = calls_of(script.track())
    assert call.was_received is received
    assert call.was_executed is any(code == S_EXECUTING for _, _, code in replies)


@pytest.mark.parametrize(
    ("captured", "unseen", "latest"),
    [
        (20, (), 20),
        (20, (21, 22), 22),
        (20, (19,), 20),
        (65535, (1,), 1),
        (1, (65535,), 1),
        (20, (20 + 0x7FFF,), 20 + 0x7FFF),
        (20, (20 + 0x8000,), 20),
    ],
)
def test_the_latest_attempt_may_be_one_that_was_not_captured(
    captured: int, unseen: tuple[int, ...], latest: int
) -> None:
    script = Script()
    script.client().ask(0, captured, 0, MOVE)
    (call,) = calls_of(script.track())
    call.unseen_serials = unseen
    assert call.latest_serial == latest


@pytest.mark.parametrize(("code", "executed"), [(0, False), (S_EXECUTING, True)])
def test_a_reply_to_an_uncaptured_attempt_shows_that_the_controller_received_the_call(
    code: int, executed: bool
) -> None:
    script = Script()
    play(script, [(0, 20, 0, MOVE), (16, -21, code), (24, 22, 20, MOVE)])
    (call,) = calls_of(script.track())
    assert (call.reply, len(call.stray_replies)) == (None, 1)
    assert (call.was_received, call.was_executed) == (True, executed)


def test_execute_questions_are_told() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, execute("CurPos"))
    assert calls_of(script.track())[0].kind == CallKind(EXECUTE, "CurPos")
