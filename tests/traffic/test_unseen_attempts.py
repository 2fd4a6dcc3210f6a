"""Attempts that the capture lacks: the serials around them show that they were sent."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import Variant
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.reserved_field import ReservedConvention
from bcapscope.traffic.unseen_attempts import MAX_UNSEEN, UnseenRequests, is_later, skipped_serials
from tests.traffic.playbook import (
    MOVE,
    OTHER,
    POSE,
    S_EXECUTING,
    Script,
    calls_of,
    play,
    strays_of,
    summaries,
)

CHAINS = [
    (0, 10, 0, MOVE),
    (8, 11, 10, MOVE),
    (16, 12, 11, MOVE),
    (17, -12, 0, POSE),
]
"""A client that is known to chain afterwards."""


@pytest.mark.parametrize(
    ("before", "after", "skipped"),
    [
        (5, 6, ()),
        (5, 5, ()),
        (5, 8, (6, 7)),
        (65534, 2, (65535, 1)),
        (65535, 1, ()),
        (8, 5, ()),
        (5, 6 + MAX_UNSEEN, tuple(range(6, 6 + MAX_UNSEEN))),
        (5, 7 + MAX_UNSEEN, ()),
    ],
)
def test_skipped_serials(before: int, after: int, skipped: tuple[int, ...]) -> None:
    assert skipped_serials(before, after) == skipped


PLAYBOOKS: dict[str, tuple[list[str], list[tuple[object, ...]]]] = {
    "a chained retry whose previous attempt was not captured": (
        [">5 >>6 <7 answered, cannot tell, unseen 21"],
        [(24, 20, 0, OTHER), (40, 22, 21, OTHER), (41, -22, 0, POSE)],
    ),
    "two attempts in a row": (
        [">5 >>6 <7 answered, cannot tell, unseen 21 22"],
        [(24, 20, 0, OTHER), (48, 23, 22, OTHER), (49, -23, 0, POSE)],
    ),
    "the reply to an attempt that was not captured comes late": (
        [">5 >>6 late<7 <8 answered, reply late, unseen 21"],
        [(24, 20, 0, OTHER), (40, 22, 21, OTHER), (40.5, -21, 0, POSE), (41, -22, 0, POSE)],
    ),
    "the attempt only came out of order": (
        [">5 >>6 >>7 <8 answered, cannot tell"],
        [(24, 20, 0, OTHER), (40, 22, 21, OTHER), (40.2, 21, 20, OTHER), (41, -22, 0, POSE)],
    ),
    "another request, so the attempt not captured is of another call": (
        [">5 unanswered, unanswered", ">>6 <7 answered, cannot tell"],
        [(24, 20, 0, OTHER), (40, 22, 21, MOVE), (41, -22, 0, POSE)],
    ),
    "the call before was answered, so the attempt not captured is of another call": (
        [">5 <6 answered, answered", ">>7 <8 answered, cannot tell"],
        [(24, 20, 0, OTHER), (25, -20, 0, POSE), (40, 22, 21, OTHER), (41, -22, 0, POSE)],
    ),
    "the serial named lies too far back": (
        [">5 unanswered, unanswered", ">>6 <7 answered, cannot tell, unseen 23"],
        [(24, 20, 0, OTHER), (40, 24, 22, OTHER), (41, -24, 0, POSE)],
    ),
}


@pytest.mark.parametrize("name", PLAYBOOKS)
def test_a_client_that_chains(name: str) -> None:
    expected, lines = PLAYBOOKS[name]
    script = Script()
    play(script, [*CHAINS, *lines])
    first, *rest = calls_of(script.track())
    assert first.convention is ReservedConvention.CHAIN
    unseen = [" ".join(["", *map(str, call.unseen_serials)]) for call in rest]
    assert [
        f"{summary.partition(': ')[2]}{serials and f', unseen{serials}'}"
        for summary, serials in zip(summaries(rest), unseen, strict=True)
    ] == expected


def test_a_client_that_is_not_known_to_chain_may_name_the_first_attempt() -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (16, 22, 21, OTHER), (17, -22, 0, POSE)])
    assert summaries(script.track()) == [
        "1: >1 not_captured, not captured",
        "2: >>2 <3 answered, cannot tell",
    ]


@pytest.mark.parametrize(("before", "is_guess"), [(MOVE, False), (OTHER, True)])
def test_a_client_that_repeats_itself_may_have_begun_another_call(
    before: tuple[int, tuple[Variant, ...]], is_guess: bool
) -> None:
    """The capture lacks attempt 21: it may be the first one of a call with the same set point."""
    script = Script()
    lines = [(19, 19, 0, before), (20, -19, 0, POSE), (24, 20, 0, OTHER), (40, 22, 21, OTHER)]
    play(script, [*CHAINS, *lines, (41, -20, 0, POSE), (41.5, -22, 0, POSE)])
    call = calls_of(script.track())[2]
    assert (call.sure_until is not None) is is_guess
    assert call.verdict is CallVerdict.REPLY_LATE  # the client went on without this reply in either case


def test_a_reply_to_an_attempt_that_was_not_captured_may_end_the_call() -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (16, -21, 0, POSE), (17, 22, 0, MOVE), (18, -22, 0, POSE)])
    call, _ = calls_of(script.track())
    assert (call.outcome, call.surely_unanswered) == (Outcome.NOT_CAPTURED, False)


@pytest.mark.parametrize(("serial", "outcome"), [(21, Outcome.UNANSWERED), (22, Outcome.NOT_CAPTURED)])
def test_the_next_request_shows_whether_the_serial_of_a_reply_was_used(serial: int, outcome: Outcome) -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (16, -21, 0, POSE), (17, serial, 0, MOVE), (18, -serial, 0, POSE)])
    settled = script.track()
    assert calls_of(settled)[0].outcome is outcome
    assert [stray.request_missed for stray in strays_of(settled)] == [serial == 22]


def test_a_skipped_serial_before_a_retry_that_names_the_first_attempt() -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (16, 22, 20, OTHER), (17, -22, 0, POSE), (18, 23, 0, MOVE)])
    first, second = calls_of(script.track())
    assert (first.retries, first.unseen_serials, first.unseen_retries) == (1, (21,), 1)
    assert (second.retries, second.unseen_serials, second.unseen_retries) == (0, (), 0)


def test_a_serial_of_a_settled_call_is_free_again() -> None:
    script = Script()
    asked = [(0, 20, 0, OTHER), (16, 22, 20, OTHER), (17, -22, 0, POSE)]
    play(script, [*asked, (9000, 30, 0, MOVE), (9100, 31, 0, MOVE), (9101, -21, 0, POSE)])
    assert "stray 6 of 1" in summaries(script.track())


def test_many_notices_do_not_hide_a_reply_that_may_end_the_call() -> None:
    script = Script()
    notices = [(20 + number, -22, S_EXECUTING) for number in range(4 * MAX_UNSEEN)]
    before, after = [(0, 20, 0, OTHER), (16, -21, 0, POSE)], [(900, 23, 0, MOVE), (901, -23, 0, POSE)]
    play(script, [*before, *notices, *after])
    assert calls_of(script.track())[0].outcome is Outcome.NOT_CAPTURED


@pytest.mark.parametrize(
    ("serial", "than", "expected"),
    [(5, 5, False), (6, 5, True), (5, 6, False), (3, 65535, True), (32772, 5, True), (32773, 5, False)],
)
def test_serials_start_again_after_65535(serial: int, than: int, expected: bool) -> None:
    assert is_later(serial, than) is expected


NOTICED: list[tuple[object, ...]] = [(0, 20, 0, OTHER), (1, -20, S_EXECUTING)]


@pytest.mark.parametrize(
    ("lines", "may_answer"),
    [
        pytest.param([NOTICED[0], (10, -21)], True, id="without notices"),
        pytest.param([NOTICED[0], (10, -21, S_EXECUTING), (11, -21)], True, id="the first notice"),
        pytest.param([*NOTICED, (10, -21, S_EXECUTING), (11, -21)], False, id="the second notice"),
        pytest.param([*NOTICED, (10, -21)], True, id="a reply after the only notice"),
        pytest.param([*NOTICED, (10, -22, S_EXECUTING), (11, -21)], True, id="a notice for a later serial"),
        pytest.param(
            [NOTICED[0], (10, -21, S_EXECUTING), (11, -22, S_EXECUTING), (12, -22)], False, id="two notices"
        ),
    ],
)
@pytest.mark.parametrize("has_next", [True, False])
def test_a_controller_sends_notices_for_one_attempt_of_a_call(
    lines: list[tuple[object, ...]], may_answer: bool, has_next: bool
) -> None:
    script = Script()
    following = [(20, 24, 0, MOVE), (21, -24)] if has_next else []
    play(script, [*lines, *following])
    assert calls_of(script.track())[0].may_go_on is may_answer


@pytest.mark.parametrize("serial", [19, 20])
def test_a_notice_for_a_serial_that_was_not_skipped_is_ignored(serial: int) -> None:
    """The next request shows that no uncaptured request had serial 22. If the client's first request has
    serial 19, the reply with serial 20 answers an uncaptured request.
    """
    script = Script()
    lines: list[tuple[object, ...]] = [(0, serial, 0, MOVE), (4, -20), (5, -22, S_EXECUTING)]
    lines += [(10, 21, 0, OTHER), (18, 22, 21, OTHER), (19, -21, 0, POSE), (20, -23, 0, POSE)]
    play(script, [*lines, (40, 24, 0, MOVE), (41, -24)])
    assert calls_of(script.track())[1].may_go_on


def test_a_chained_retry_shows_which_uncaptured_attempt_belongs_to_its_call() -> None:
    script = Script()
    lines = [(24, 20, 0, OTHER), (30, -21, 0, POSE), (38, -22, 0, POSE), (48, 23, 22, OTHER)]
    play(script, [*CHAINS, *lines])
    call = calls_of(script.track())[1]
    assert [reply.item.serial for reply in call.stray_replies] == [22]
    assert (call.may_go_on, call.sure_until) == (True, 20)


def test_a_notice_and_a_reply_of_each_uncaptured_attempt_are_remembered() -> None:
    script = Script()
    lines: list[tuple[object, ...]] = [(0, 20, 0, OTHER)]
    for step in range(1, MAX_UNSEEN + 1):
        lines += [(8 * step, -20 - step, S_EXECUTING), (8 * step + 1, -20 - step, 0, POSE)]
    play(script, [*lines, (600, 21 + MAX_UNSEEN, 20, OTHER)])
    (call,) = calls_of(script.track())
    assert len(call.stray_replies) == 2 * MAX_UNSEEN


def test_a_copy_of_the_latest_request_shows_nothing_about_stray_replies() -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (10, -21, 0, POSE)])
    settled = script.track()
    (newest,), (stray,) = calls_of(settled), strays_of(settled)
    unseen = UnseenRequests()
    unseen.add_stray_reply(stray, newest)
    assert unseen.pop_before(20) == []
    assert unseen.pop_before(22) == [stray]
    assert unseen.pop_before(22) == []


def test_a_lost_reply_to_an_earlier_attempt_overtakes_nothing() -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (1, -20, 0, POSE), (8, 21, 20, OTHER), (24, 23, 22, OTHER)])
    first, _ = calls_of(script.track())
    assert (first.may_go_on, first.was_overtaken) == (True, False)


def test_a_call_executed_after_another_one_is_no_retry() -> None:
    """The controller sends S_EXECUTING only once for each call, so 22 and 24 are different calls."""
    script = Script()
    lines = [(0, 20, 0, OTHER), (40, 22, 21, OTHER), (41, -22, S_EXECUTING), (80, 24, 23, OTHER)]
    play(script, [*lines, (81, -24, S_EXECUTING), (82, -24, 0, POSE)])
    assert [call.may_go_on for call in calls_of(script.track())] == [False, False, False]


def test_a_stray_reply_to_a_complete_call_shows_no_missed_request() -> None:
    script = Script()
    play(script, [(0, 20, 0, OTHER), (1, -20), (9000, 21, 0, MOVE), (9100, 22, 0, MOVE), (9101, -20, 1)])
    assert [(stray.call_number, stray.request_missed) for stray in strays_of(script.track())] == [(1, False)]
