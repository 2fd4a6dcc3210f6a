"""Attempts that were not captured leave a verdict open only as far as they matter to it."""

from __future__ import annotations

import pytest

from bcapscope.traffic.call import Call
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.tracker import Tracker
from tests.traffic.playbook import MOVE, OTHER, POSE, S_EXECUTING, Script, calls_of, play
from tests.traffic.test_unseen_attempts import CHAINS

LATE, LOST, UNSURE = CallVerdict.REPLY_LATE, CallVerdict.REPLY_LOST, CallVerdict.CANNOT_TELL
REQUEST_LOST = CallVerdict.REQUEST_LOST


def tracked(lines: list[tuple[object, ...]], taken_at: CapturePoint | None = None) -> list[Call]:
    script = Script()
    play(script, lines)
    tracker = Tracker(taken_at)
    settled = [item for seen in script.seen for item in tracker.observe(seen)]
    return calls_of([*settled, *tracker.close()])


UNSEEN_RETRY: list[tuple[object, ...]] = [(0, 20, 0, OTHER), (16, 22, 20, OTHER), (17, -22, 0, POSE)]
UNSEEN_FIRST: list[tuple[object, ...]] = [(16, 22, 20, OTHER), (17, -22, 0, POSE)]


@pytest.mark.parametrize("lines", [UNSEEN_RETRY, UNSEEN_FIRST])
@pytest.mark.parametrize(
    ("taken_at", "verdict"),
    [
        (None, UNSURE),
        (CapturePoint.CLIENT, UNSURE),
        (CapturePoint.BETWEEN, UNSURE),
        (CapturePoint.CONTROLLER, REQUEST_LOST),
    ],
)
def test_an_attempt_without_a_reply_at_the_controller_did_not_reach_it(
    lines: list[tuple[object, ...]], taken_at: CapturePoint | None, verdict: CallVerdict
) -> None:
    assert tracked(lines, taken_at)[0].verdict is verdict


def test_an_attempt_whose_reply_was_captured_reached_the_controller() -> None:
    lines: list[tuple[object, ...]] = [(0, 20, 0, OTHER), (8, -20, 0, POSE), (9, -21, 0, POSE)]
    (call,) = tracked([*lines, (10, 22, 20, OTHER), (11, -22, 0, POSE)], CapturePoint.CONTROLLER)
    assert call.verdict is UNSURE


@pytest.mark.parametrize(("retried_at", "verdict"), [(90, UNSURE), (110, LOST)])
def test_a_reply_to_an_attempt_that_was_not_captured_counts(retried_at: float, verdict: CallVerdict) -> None:
    lines: list[tuple[object, ...]] = [(0, 20, 0, OTHER), (8, -21, 0, POSE)]
    (call,) = tracked([*lines, (8 + retried_at, 22, 20, OTHER), (9 + retried_at, -22, 0, POSE)])
    assert (call.verdict, [each.item.serial for each in call.stray_replies]) == (verdict, [21])


@pytest.mark.parametrize(("retried_at", "verdict"), [(90, UNSURE), (110, LOST)])
def test_a_reply_to_a_first_attempt_that_was_not_captured_counts(
    retried_at: float, verdict: CallVerdict
) -> None:
    lines: list[tuple[object, ...]] = [(0, 5, 0, MOVE), (1, -5, 0, POSE), (8, -20, 0, POSE)]
    _, call = tracked([*lines, (8 + retried_at, 21, 20, OTHER), (9 + retried_at, -21, 0, POSE)])
    assert (call.verdict, call.retries, call.outcome) == (verdict, 1, Outcome.ANSWERED)


def test_a_late_reply_counts_although_the_call_may_go_on() -> None:
    lines: list[tuple[object, ...]] = [(0, 20, 0, OTHER), (8, 21, 20, OTHER), (9, -20, 0, POSE)]
    call, _ = tracked([*lines, (16, -22, 0, POSE), (17, 23, 0, MOVE), (18, -23, 0, POSE)])
    assert (call.verdict, call.outcome) == (LATE, Outcome.NOT_CAPTURED)


@pytest.mark.parametrize(("noticed", "verdict"), [(20, UNSURE), (21, REQUEST_LOST)])
def test_a_notice_decides_where_the_reply_may_have_crossed(noticed: int, verdict: CallVerdict) -> None:
    lines: list[tuple[object, ...]] = [(0, 20, 0, OTHER)]
    lines += [(8, 21, 20, OTHER)] if noticed == 21 else []
    lines += [(9, -noticed, S_EXECUTING), (15, -noticed, 0, POSE), (16, 22, 20, OTHER), (17, -22, 0, POSE)]
    assert tracked(lines)[0].verdict is verdict


@pytest.mark.parametrize(
    ("known", "outcome"),
    [
        ([(0, 10, 0, MOVE), (8, 11, 10, MOVE), (16, 12, 10, MOVE), (17, -12, 0, POSE)], Outcome.UNANSWERED),
        ([(0, 10, 10, MOVE), (1, -10, 0, POSE)], Outcome.UNANSWERED),
        (CHAINS[:0], Outcome.NOT_CAPTURED),
    ],
)
def test_a_client_that_names_first_attempts_began_another_call(
    known: list[tuple[object, ...]], outcome: Outcome
) -> None:
    """The client repeats its set point, and the capture lacks attempt 21."""
    first = 20 if known and known[0][2] else 0
    lines: list[tuple[object, ...]] = [(24, 20, first, OTHER), (40, 22, 21, OTHER), (41, -22, 0, POSE)]
    assert [call.outcome for call in tracked([*known, *lines])][-2:] == [outcome, Outcome.ANSWERED]


def test_a_call_does_not_go_on_in_calls_without_a_reply() -> None:
    lines: list[tuple[object, ...]] = [(0, 20, 0, OTHER), (16, 22, 21, OTHER), (40, 30, 0, MOVE)]
    assert tracked([*lines, (41, -30, 0, POSE)])[0].outcome is Outcome.UNANSWERED


def test_a_notice_for_an_earlier_attempt_restarts_no_wait() -> None:
    """The client gave up 8 ms after its last attempt, just when S_EXECUTING for the first one came."""
    lines: list[tuple[object, ...]] = []
    for number in range(4):
        lines += [(number, 10 + number, 0, OTHER), (number + 0.5, -10 - number, 0, POSE)]
    lines += [(10, 20, 0, OTHER), (18, 21, 20, OTHER), (25, -20, S_EXECUTING), (26, 22, 0, MOVE)]
    lines += [(27, -22, 0, POSE), (100, 30, 0, OTHER), (101, -30, 0, POSE), (108, 31, 30, OTHER)]
    call = tracked([*lines, (109, -31, 0, POSE)])[-1]
    assert call.verdict is LOST


@pytest.mark.parametrize(("code", "was_executed"), [(0, False), (S_EXECUTING, True)])
def test_a_reply_to_an_attempt_that_was_not_captured_shows_that_the_call_arrived(
    code: int, was_executed: bool
) -> None:
    (call,) = tracked([(0, 20, 0, OTHER), (8, -21, code, POSE), (10, 22, 20, OTHER)])
    assert (call.reply, [each.item.serial for each in call.stray_replies]) == (None, [21])
    assert (call.was_received, call.was_executed) == (True, was_executed)
