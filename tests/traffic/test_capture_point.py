"""Where a capture was taken, and what it can tell about a reply shortly before a retry."""

from __future__ import annotations

from typing import Any

import pytest

from bcapscope.traffic.call import Call
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.capture_point import (
    CROSSING_AT_CLIENT_NS,
    LONGEST_ROUND_TRIP_NS,
    CapturePoint,
    CrossingWindow,
)
from bcapscope.traffic.pipeline import CallCollector, Pipeline
from tests.traffic.playbook import MOVE, MS, OTHER, POSE, S_EXECUTING, Script, calls_of, slv_move

LOST, UNSURE = CallVerdict.REPLY_LOST, CallVerdict.CANNOT_TELL


@pytest.mark.parametrize("taken_at", [None, CapturePoint.CONTROLLER, CapturePoint.BETWEEN])
def test_without_reactions_the_client_may_be_far_away(taken_at: CapturePoint | None) -> None:
    assert CrossingWindow(taken_at).nanoseconds == LONGEST_ROUND_TRIP_NS


def test_the_third_shortest_reaction_counts() -> None:
    window = CrossingWindow()
    for reaction in (5 * MS, 1 * MS, 9 * MS):
        assert reaction < window.considered_below_ns
        window.add_reaction(reaction)
    assert window.considered_below_ns == 9 * MS
    window.add_reaction(2 * MS)
    assert window.considered_below_ns == 5 * MS
    assert window.nanoseconds == 2 * 5 * MS + CROSSING_AT_CLIENT_NS


def test_on_the_computer_of_the_client_no_reaction_is_considered() -> None:
    assert CrossingWindow(CapturePoint.CLIENT).considered_below_ns == 0


def test_ignored_reactions_leave_the_window_as_wide_as_without_any() -> None:
    window = CrossingWindow()
    for _ in range(3):
        window.add_reaction(MS)
    window.ignore_reactions()
    assert (window.considered_below_ns, window.nanoseconds) == (0, LONGEST_ROUND_TRIP_NS)


def test_clocks_that_go_back_show_no_negative_round_trip() -> None:
    window = CrossingWindow()
    for _ in range(3):
        window.add_reaction(-MS)
    assert window.nanoseconds == CROSSING_AT_CLIENT_NS


def verdict(
    reaction: float, gap: float, taken_at: CapturePoint | None = None, before: int = 3, retry: int = 11
) -> CallVerdict:
    """Return the verdict on a call whose reply was captured `gap` ms before the retry.

    The client made each of `before` calls `reaction` ms after the reply to the one before.
    """
    script = Script()
    client = script.client()
    at = 0.0
    for number in range(before + 1):
        client.ask(at, 1 + number, 0, OTHER)
        client.reply(at + 0.5, 1 + number)
        at += 0.5 + reaction
    at += 1000
    client.ask(at, 10, 0, MOVE)
    client.reply(at + 5, 10, 0, 0, POSE)
    client.ask(at + 5 + gap, retry, 10, MOVE)
    client.reply(at + 6 + gap, retry, 0, 0, POSE)
    return played(script, taken_at)[-1].verdict


def played(script: Script, taken_at: CapturePoint | None = None) -> list[Call]:
    calls = CallCollector()
    pipeline = Pipeline(calls, taken_at=taken_at)
    for observation in script.seen:
        pipeline.add(observation)
    pipeline.finish()
    return calls.calls


@pytest.mark.parametrize(
    ("reaction", "gap", "expected"),
    [
        (0.2, 0.8, UNSURE),
        (0.2, 1.0, LOST),
        (2.0, 4.4, UNSURE),
        (2.0, 4.6, LOST),
        (7.5, 1.0, UNSURE),
        (60, 99, UNSURE),
        (60, 100, UNSURE),
        (60, 101, LOST),
    ],
)
def test_the_traffic_shows_how_far_the_client_is(reaction: float, gap: float, expected: CallVerdict) -> None:
    assert verdict(reaction, gap) is expected


def test_a_few_reactions_show_nothing() -> None:
    assert verdict(0.2, 10.0, before=2) is UNSURE
    assert verdict(0.2, 10.0, before=3) is LOST


@pytest.mark.parametrize("reaction", [0.1, 7.5])
@pytest.mark.parametrize(("gap", "expected"), [(0.4, UNSURE), (0.5, UNSURE), (0.6, LOST)])
def test_a_capture_at_the_client_needs_no_reactions(
    reaction: float, gap: float, expected: CallVerdict
) -> None:
    assert verdict(reaction, gap, CapturePoint.CLIENT) is expected


@pytest.mark.parametrize("taken_at", [CapturePoint.BETWEEN, CapturePoint.CONTROLLER])
@pytest.mark.parametrize(
    ("reaction", "gap", "expected"),
    [(0.2, 0.8, UNSURE), (0.2, 1.0, LOST), (7.5, 15.4, UNSURE), (7.5, 15.6, LOST), (60, 99, UNSURE)],
)
def test_elsewhere_the_traffic_shows_how_far_the_client_is(
    taken_at: CapturePoint, reaction: float, gap: float, expected: CallVerdict
) -> None:
    assert verdict(reaction, gap, taken_at) is expected


def test_an_attempt_that_was_not_captured_may_have_crossed_the_reply() -> None:
    assert verdict(0.2, 30.0, retry=12) is UNSURE


@pytest.mark.parametrize(("retry", "expected"), [(11, LOST), (12, UNSURE)])
def test_a_reaction_counts_only_if_no_attempt_may_lie_before_it(retry: int, expected: CallVerdict) -> None:
    """Where a serial is skipped, the client may have sent a retry in vain and gone on when the reply came."""
    script = Script()
    client = script.client()
    for number in range(4):
        at, serial = 100.0 * number, 20 * number + 10
        client.ask(at, serial, 0, OTHER)
        client.reply(at + 0.5, serial)
        client.ask(at + 0.7, serial + retry - 10, 0, OTHER)
        client.reply(at + 20, serial + retry - 10)
    client.ask(1000, 100, 0, MOVE)
    client.reply(1001, 100, 0, 0, POSE)
    client.ask(1008, 101, 100, MOVE)
    client.reply(1009, 101, 0, 0, POSE)
    assert played(script)[-1].verdict is expected


def test_a_reply_to_a_retry_shows_no_reaction() -> None:
    """The capture lacks the first attempts, and the retries may have been the last ones."""
    script = Script()
    client = script.client()
    for number in range(4):
        at, serial = 100.0 * number, 3 * number + 10
        client.ask(at, serial + 1, serial, OTHER)
        client.reply(at + 0.5, serial + 1)
        client.ask(at + 0.7, serial + 2, 0, OTHER)
    client.ask(1000, 100, 0, MOVE)
    client.reply(1001, 100, 0, 0, POSE)
    client.ask(1008, 101, 100, MOVE)
    client.reply(1009, 101, 0, 0, POSE)
    assert played(script)[-1].verdict is UNSURE


def test_a_client_that_does_not_wait_for_replies_shows_nothing() -> None:
    script = Script()
    client = script.client()
    for number in range(8):
        client.ask(8 * number, 1 + number, 0, OTHER)
        client.reply(8 * number + 7.9, 1 + number)
    client.ask(64, 20, 0, OTHER)
    client.ask(65, 21, 0, MOVE)
    client.reply(66, 20)
    client.reply(67, 21, 0, 0, POSE)
    client.ask(72, 22, 21, MOVE)
    client.reply(73, 22, 0, 0, POSE)
    assert played(script)[-1].verdict is UNSURE


@pytest.mark.parametrize(("is_first", "is_known"), [(False, True), (True, False)])
def test_a_retry_soon_after_a_notice_does_not_show_when_its_call_began(
    is_first: bool, is_known: bool
) -> None:
    script = Script()
    client = script.client()
    for serial in range(1, 5):
        client.ask(10 * serial, serial, 0, slv_move(float(serial)))
        client.reply(10 * serial + 9, serial)
    client.ask(50, 5, 0, MOVE)
    client.reply(59, 5, 0, S_EXECUTING)
    client.ask(60, 6 if is_first else 7, 0 if is_first else 6, OTHER)
    client.reply(61, 6 if is_first else 7)
    client.ask(70, 8, 0, MOVE)
    client.ask(78, 9, 8, MOVE)
    client.reply(79, 9)
    call = calls_of(script.track())[-1]
    assert (call.crossing_ns < 3 * MS) is is_known


def test_a_request_at_the_same_time_as_a_reply_shows_nothing_if_the_client_does_not_wait() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.reply(1, 1)
    following: Any = client.ask(1, 2, 0, OTHER)
    call = calls_of(script.track())[0]
    window = CrossingWindow()
    window.ignore_reactions()
    for _ in range(3):
        window.add_answered_call(call, following)
    assert window.nanoseconds == LONGEST_ROUND_TRIP_NS
