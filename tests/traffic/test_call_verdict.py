"""What became of a call: more than once, or not as far as anyone can tell."""

from __future__ import annotations

from typing import Any

import pytest

from bcapscope.traffic.call import CallFrame, FrameRole
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.conversation_pairing import ConversationPairing
from bcapscope.traffic.joining.joined_observation import join_sightings
from tests.traffic.playbook import (
    CONNECT,
    GET_ROBOT,
    GET_VARIABLE,
    MOVE,
    POSE,
    START_SERVICE,
    Script,
    calls_of,
    i4,
    play,
    r8s,
    text,
)


def test_skipped_handles_show_that_a_call_was_executed_more_than_once() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, (text(""), text(""), text(""), text(""))))
    client.reply(1, 1, 0, 0, i4(1))
    get_robot = (GET_ROBOT, (i4(1), text("Arm"), text("")))
    client.ask(2, 2, 2, get_robot)
    client.ask(22, 3, 2, get_robot)
    client.ask(42, 4, 2, get_robot)
    client.reply(43, 4, 0, 0, i4(4))
    client.ask(50, 5, 5, (GET_VARIABLE, (i4(1), text("I1"), text(""))))
    client.reply(51, 5, 0, 0, i4(5))
    _, robot, variable = calls_of(script.track())
    assert (robot.verdict, robot.skipped_handles) == (CallVerdict.EXECUTED_TWICE, 2)
    assert (variable.verdict, variable.skipped_handles) == (CallVerdict.ANSWERED, 0)


@pytest.mark.parametrize(
    ("first", "second", "tries"),
    [
        (1, 5, 3),  # more skipped than tries went unanswered
        (5, 1, 3),  # not in sequence
        (1, 2, 3),  # none skipped
        (1, 3, 1),  # not tried again
    ],
)
def test_other_handles_show_nothing(first: int, second: int, tries: int) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.reply(1, 1, 0, 0, i4(first))
    for step in range(tries):
        client.ask(2 + 20 * step, 2 + step, 2, (GET_ROBOT, (i4(1),)))
    client.reply(100, 1 + tries, 0, 0, i4(second))
    assert calls_of(script.track())[1].skipped_handles == 0


def test_handles_begin_anew_with_the_session() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.reply(1, 1, 0, 0, i4(1))
    client.ask(2, 2, 2, START_SERVICE)
    client.reply(3, 2)
    client.ask(4, 3, 3, (CONNECT, ()))
    client.ask(24, 4, 3, (CONNECT, ()))
    client.reply(25, 4, 0, 0, i4(3))
    assert calls_of(script.track())[2].verdict is CallVerdict.CANNOT_TELL


@pytest.mark.parametrize("result", [text("no handle"), r8s(1.0)])
def test_a_result_that_is_no_handle_is_left_alone(result: object) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.reply(1, 1, 0, 0, result)  # type: ignore[arg-type]  # a Variant
    client.ask(2, 2, 2, (CONNECT, ()))
    client.reply(3, 2, 0, 0)
    assert [call.verdict for call in calls_of(script.track())] == [CallVerdict.ANSWERED] * 2


def test_handles_show_nothing_if_the_capture_lacks_the_start_of_the_session() -> None:
    script = Script()
    play(script, [(0, 1, 0, (CONNECT, ())), (20, 2, 1, (CONNECT, ())), (21, -2, 0, i4(3))])
    (call,) = calls_of(script.track())
    assert (call.skipped_handles, call.verdict) == (0, CallVerdict.CANNOT_TELL)


def test_one_skipped_handle_shows_that_a_call_was_executed_twice() -> None:
    script = Script()
    get_robot = (GET_ROBOT, (i4(1),))
    opened = [(0, 1, 0, (CONNECT, ())), (1, -1, 0, i4(1))]
    play(script, [*opened, (2, 2, 0, get_robot), (22, 3, 2, get_robot), (23, -3, 0, i4(3))])
    assert calls_of(script.track())[1].skipped_handles == 1


def test_replies_with_different_codes_show_that_a_call_was_executed_twice() -> None:
    script = Script()
    play(script, [(0, 1, 0, MOVE), (1, -1, 0, POSE), (8, 2, 1, MOVE), (9, -2, 1, POSE)])
    (call,) = calls_of(script.track())
    assert call.verdict is CallVerdict.EXECUTED_TWICE


@pytest.mark.parametrize(
    ("sure_until", "verdict"), [(None, CallVerdict.REQUEST_LOST), (20, CallVerdict.CANNOT_TELL)]
)
def test_a_lost_attempt_counts_only_if_it_surely_belongs_to_the_call(
    sure_until: int | None, verdict: CallVerdict
) -> None:
    script = Script()
    play(script, [(0, 20, 0, MOVE), (8, 21, 20, MOVE), (16, 22, 20, MOVE), (17, -22, 0, POSE)])
    lost = script.seen[1]
    (call,) = calls_of(script.track())
    joined: Any = join_sightings(lost, None, lost.flow, is_missed=True)
    call.other_frames = [CallFrame(FrameRole.RETRY, joined), *list(call.other_frames)[1:]]
    call.sure_until = sure_until
    assert call.verdict is verdict


def test_a_reply_that_the_network_lost_is_lost_even_if_a_copy_arrived() -> None:
    script = Script()
    client = script.client()
    request = client.ask(0, 1, 0, MOVE)
    lost, reply = client.reply(1, 1, 0, 0, POSE), client.reply(2, 1, 1, 0, POSE)
    pairing: Any = ConversationPairing(client.conversation, 0)
    pairing.add_request(request, request.item, 1)
    pairing.add_undelivered_reply(lost, lost.item)
    pairing.add_reply(reply, reply.item)
    (call,) = pairing.close(0)
    assert (call.outcome, call.verdict) == (Outcome.ANSWERED, CallVerdict.REPLY_LOST)
