"""A packet that the capture holds twice is one packet."""

from __future__ import annotations

import pytest

from bcapscope.traffic.call_verdict import CallVerdict
from tests.traffic.playbook import MOVE, POSE, Script, calls_of


def test_a_capture_on_two_interfaces_shows_each_packet_once() -> None:
    script = Script()
    client = script.client()
    for serial in range(1, 4):
        for copy in (0, 0.05):
            client.ask(8 * serial + copy, serial, 0, MOVE)
        for copy in (1, 1.05):
            client.reply(8 * serial + copy, serial, 0, 0, POSE)
    calls = calls_of(script.track())
    assert len(calls) == 3
    for call in calls:
        assert (len(call.attempts), call.duplicates, call.late_replies) == (1, (), ())
        assert (len(call.captured_again), call.verdict) == (2, CallVerdict.ANSWERED)


@pytest.mark.parametrize(("later", "copies"), [(1.0, (0, 1)), (1.000001, (1, 0)), (1.5, (1, 0))])
def test_a_copy_that_comes_later_was_made_by_the_network(later: float, copies: tuple[int, int]) -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(later, 1, 0, MOVE)
    client.reply(3, 1, 0, 0, POSE)
    (call,) = calls_of(script.track())
    assert (len(call.duplicates), len(call.captured_again)) == copies


def test_a_retry_right_after_its_first_attempt_is_a_retry() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    client.ask(0.1, 2, 1, MOVE)
    client.reply(3, 2, 0, 0, POSE)
    (call,) = calls_of(script.track())
    assert (call.retries, call.captured_again) == (1, ())
