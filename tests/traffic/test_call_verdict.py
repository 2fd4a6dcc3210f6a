"""What became of a call: more than once, or not as far as anyone can tell."""

from __future__ import annotations

import pytest

from bcapscope.traffic.call_verdict import CallVerdict
from tests.traffic.playbook import (
    CONNECT,
    GET_ROBOT,
    GET_VARIABLE,
    START_SERVICE,
    Script,
    calls_of,
    i4,
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
