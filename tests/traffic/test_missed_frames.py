"""What the capture lacks: bytes of a stream, or one direction of a conversation."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Malformed
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.handle_tracker import MAX_OBJECTS
from bcapscope.traffic.observation import Direction, Transport
from bcapscope.traffic.requests_only import FEWEST_CALLS
from tests.samples.problems import problem_of
from tests.traffic.playbook import (
    CONNECT,
    EXECUTE,
    GET_ROBOT,
    GET_VARIABLE,
    MOVE,
    OTHER,
    S_EXECUTING,
    START_SERVICE,
    Client,
    Script,
    calls_of,
    execute,
    i4,
    slv_move,
    strays_of,
    text,
)

GAP = Malformed(b"", (), 44)
CUT = Malformed(b"\x01\x10", (problem_of(2, "cut", "the capture kept 2 bytes"),))


def outcomes(script: Script) -> list[str]:
    return [call.outcome.value for call in calls_of(script.track())]


@pytest.mark.parametrize("waits", [1.0, 20.0])
def test_a_gap_in_the_replies_may_hold_the_reply(waits: float) -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 1, 0, MOVE)
    client.ask(waits, 2, 0, OTHER)
    client.see(waits + 1, Direction.RESPONSE, GAP)
    client.reply(waits + 1, 2)
    client.ask(5000, 3, 0, MOVE)
    calls = calls_of(script.track())
    assert [call.outcome for call in calls] == [
        Outcome.NOT_CAPTURED,
        Outcome.ANSWERED,
        Outcome.CAPTURE_ENDED,
    ]
    assert calls[0].verdict is CallVerdict.NOT_CAPTURED
    assert not calls[0].surely_unanswered


def test_a_cut_reply_may_answer_the_retry_of_an_answered_call() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.reply(1, 1)
    client.ask(200, 2, 1, MOVE)
    client.see(201, Direction.RESPONSE, CUT)
    client.ask(8000, 3, 0, OTHER)
    client.reply(8001, 3)
    assert outcomes(script) == ["not_captured", "answered"]


def test_a_gap_after_a_later_reply_does_not_hold_an_earlier_one() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 1, 0, MOVE)
    client.ask(20, 2, 0, OTHER)
    client.reply(21, 2)
    client.see(22, Direction.RESPONSE, GAP)
    client.ask(30, 3, 0, MOVE)
    assert outcomes(script) == ["unanswered", "answered", "capture_ended"]


def test_a_reply_behind_the_gap_counts() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 1, 0, MOVE)
    client.see(1, Direction.RESPONSE, GAP)
    client.reply(2, 1)
    client.ask(10, 2, 0, MOVE)
    client.see(30, Direction.RESPONSE, GAP)
    client.ask(40, 3, 0, MOVE)
    client.reply(50, 2)
    client.reply(51, 3)
    assert outcomes(script) == ["answered", "unanswered", "answered"]


def test_a_gap_in_the_requests_says_nothing_about_replies() -> None:
    script = Script()
    client = script.client(transport=Transport.TCP)
    client.ask(0, 1, 0, MOVE)
    client.see(1, Direction.REQUEST, GAP)
    client.ask(20, 2, 0, OTHER)
    client.reply(21, 2)
    assert outcomes(script) == ["unanswered", "answered"]


def test_a_reply_of_which_the_capture_kept_a_few_bytes() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.see(1, Direction.RESPONSE, CUT)
    client.ask(20, 2, 0, OTHER)
    client.reply(21, 2)
    assert outcomes(script) == ["not_captured", "answered"]


@pytest.mark.parametrize(
    ("serial", "is_missed"),
    [(6, True), (69, True), (70, False), (4, True), (700, False), (0xFFFF, True), (0x8000, False)],
)
def test_a_reply_to_a_serial_close_by_answers_a_request_that_was_not_captured(
    serial: int, is_missed: bool
) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 5, 0, MOVE)
    client.reply(1, 5)
    client.reply(6001, serial)
    (stray,) = strays_of(script.track())
    assert stray.request_missed is is_missed


GET_VARIABLE_OF_1 = (GET_VARIABLE, (i4(1), text("I1"), text("")))
GET_ROBOT_OF_1 = (GET_ROBOT, (i4(1), text("Arm"), text("")))


def test_a_client_that_uses_the_handle_had_a_reply() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, START_SERVICE)
    client.ask(2000, 2, 2, (CONNECT, ()))
    client.ask(4000, 3, 3, GET_ROBOT_OF_1)
    assert outcomes(script) == ["not_captured"] * 3


def test_a_handle_from_before_the_capture_proves_nothing() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, GET_VARIABLE_OF_1)
    client.ask(1000, 2, 1, GET_VARIABLE_OF_1)
    client.ask(2000, 3, 3, MOVE)
    assert outcomes(script) == ["unanswered", "capture_ended"]


@pytest.mark.parametrize("handle", [0, -1])
def test_a_client_that_uses_no_handle_may_have_had_no_reply(handle: int) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, (CONNECT, ()))
    client.ask(1000, 2, 2, (GET_ROBOT, (i4(handle), text("Arm"), text(""))))
    assert outcomes(script) == ["unanswered", "capture_ended"]


@pytest.mark.parametrize(
    ("calls", "every", "proven"),
    [
        (FEWEST_CALLS, 8, True),
        (FEWEST_CALLS - 1, 8, False),
        (FEWEST_CALLS, 499.999999, True),
        (FEWEST_CALLS, 500, False),
    ],
)
def test_several_calls_in_a_row_without_a_retry(calls: int, every: float, proven: bool) -> None:
    script = Script()
    client = script.client()
    for number in range(calls):
        client.ask(every * number, 1 + number, 1 + number, slv_move(float(number)))
    assert ("not_captured" in outcomes(script)) is proven


@pytest.mark.parametrize(("calls", "proven"), [(FEWEST_CALLS, True), (FEWEST_CALLS - 1, False)])
def test_calls_before_a_pause_do_not_count(calls: int, proven: bool) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, slv_move(0.0))
    for number in range(2, calls + 2):
        client.ask(1000 + 8 * number, number, number, slv_move(float(number)))
    assert ("not_captured" in outcomes(script)) is proven


def test_retries_show_that_replies_were_missing() -> None:
    script = Script()
    client = script.client()
    for number in range(0, 4 * FEWEST_CALLS, 2):
        client.ask(8 * number, 1 + number, 1 + number, slv_move(float(number)))
        client.ask(8 * number + 8, 2 + number, 1 + number, slv_move(float(number)))
    assert "not_captured" not in outcomes(script)


@pytest.mark.parametrize("code", [0, S_EXECUTING, 0x809100AA])
def test_one_frame_of_the_controller_shows_that_both_directions_were_captured(code: int) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 1, MOVE)
    client.reply(1, 1, 0, code)
    for number in range(2, 3 * FEWEST_CALLS):
        client.ask(8 * number, 1 + number, 1 + number, slv_move(float(number)))
    assert "not_captured" not in outcomes(script)


def opened_robot(script: Script, transport: Transport = Transport.UDP, *, is_begun: bool = True) -> Client:
    """Open a robot. The capture lacks the reply, which held the handle 7."""
    client = script.client(transport=transport)
    if is_begun:
        client.ask(0, 1, 0, START_SERVICE)
        client.reply(1, 1)
    client.ask(2, 2, 0, (CONNECT, (text("b-CAP"), text(""), text(""), text(""))))
    client.reply(3, 2, 0, 0, i4(5))
    client.ask(10, 3, 0, (GET_ROBOT, (i4(5), text("Arm"), text(""))))
    return client


@pytest.mark.parametrize("takes", [1, 3000])
def test_a_handle_that_the_controller_accepts_proves_the_reply_that_the_capture_lacks(takes: float) -> None:
    script = Script()
    client = opened_robot(script)
    client.ask(20, 4, 0, execute("TakeArm", 7))
    client.reply(20 + takes, 4)
    client.ask(20000, 5, 0, (4000, ()))
    client.reply(20001, 5, 0, 0, i4(1))
    _, _, opening, *_ = calls_of(script.track())
    assert (opening.outcome, opening.verdict) == (Outcome.NOT_CAPTURED, CallVerdict.NOT_CAPTURED)
    assert not opening.surely_unanswered


@pytest.mark.parametrize(
    ("handle", "code"),
    [
        pytest.param(7, 0x80070006, id="refused"),
        pytest.param(0, 0, id="none"),
        pytest.param(6, 0, id="known"),
    ],
)
def test_other_handles_prove_no_reply(handle: int, code: int) -> None:
    script = Script()
    client = opened_robot(script)
    client.ask(15, 4, 0, (GET_ROBOT, (i4(5), text("Other"), text(""))))
    client.reply(16, 4, 0, 0, i4(6))
    client.ask(20, 5, 0, execute("TakeArm", handle))
    client.reply(21, 5, 0, code)
    assert outcomes(script)[2] == "unanswered"


def test_a_request_without_a_handle_proves_no_reply() -> None:
    script = Script()
    client = opened_robot(script)
    client.ask(20, 4, 0, (EXECUTE, (text("TakeArm"),)))
    client.reply(21, 4)
    assert outcomes(script)[2] == "unanswered"


@pytest.mark.parametrize("transport", Transport)
def test_a_handle_proves_nothing_if_it_may_be_older_or_nothing_is_lost(transport: Transport) -> None:
    script = Script()
    client = opened_robot(script, transport, is_begun=transport is Transport.TCP)
    client.ask(20, 4, 0, execute("TakeArm", 7))
    client.reply(21, 4)
    opening = next(call for call in calls_of(script.track()) if call.kind.function_id == GET_ROBOT)
    assert opening.outcome is Outcome.UNANSWERED


def test_a_handle_of_the_next_session_proves_nothing() -> None:
    script = Script()
    client = opened_robot(script)
    client.ask(20, 4, 0, START_SERVICE)
    client.reply(21, 4)
    client.ask(30, 5, 0, execute("TakeArm", 7))
    client.reply(31, 5)
    assert outcomes(script)[2] == "unanswered"


def test_a_handle_in_a_late_reply_is_known() -> None:
    script = Script()
    client = opened_robot(script)
    client.reply(18, 3, 0, 0, i4(7))
    client.ask(20, 4, 0, execute("TakeArm", 7))
    client.reply(21, 4)
    assert outcomes(script)[2] == "answered"


@pytest.mark.parametrize(
    ("handles", "outcome"), [(MAX_OBJECTS, "not_captured"), (MAX_OBJECTS + 1, "unanswered")]
)
def test_many_handles_prove_nothing(handles: int, outcome: str) -> None:
    script = Script()
    client = opened_robot(script)
    client.reply(11, 3, 0, 0, i4(6))
    for number in range(handles - 2):
        client.ask(100 + number, 4 + number, 0, (GET_ROBOT, (i4(5), text("Arm"), text(""))))
        client.reply(100.5 + number, 4 + number, 0, 0, i4(8 + number))
    client.ask(20000, 9000, 0, (GET_ROBOT, (i4(5), text("Arm"), text(""))))
    client.ask(30000, 9001, 0, execute("TakeArm", 7))
    client.reply(30001, 9001)
    assert outcomes(script)[-2] == outcome
