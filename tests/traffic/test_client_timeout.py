"""What the distances between attempts show: when a client gives up, and which replies come too late."""

from __future__ import annotations

import pytest

from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.client_timeout import attempt_distances, gives_up_at, waits_in_vain
from bcapscope.traffic.observation import Transport
from tests.traffic.playbook import (
    MOVE,
    MS,
    OTHER,
    POSE,
    S_EXECUTING,
    START,
    Script,
    calls_of,
    execute,
    play,
    summaries,
)

SET_POINTS: list[tuple[object, ...]] = [(0, 1, 0, MOVE), (1, -1, 0, POSE)]
TWO_ATTEMPTS: list[tuple[object, ...]] = [(10, 2, 0, OTHER), (12, 3, 2, OTHER)]


@pytest.mark.parametrize(
    ("lines", "ends", "outcome"),
    [
        (TWO_ATTEMPTS, 61.9, Outcome.CAPTURE_ENDED),
        (TWO_ATTEMPTS, 62.1, Outcome.UNANSWERED),
        (TWO_ATTEMPTS, 30_000, Outcome.UNANSWERED),
        ([(10, 2, 0, OTHER), (110, 3, 2, OTHER)], 509, Outcome.CAPTURE_ENDED),
        ([(10, 2, 0, OTHER), (110, 3, 2, OTHER)], 511, Outcome.UNANSWERED),
        ([*TWO_ATTEMPTS, (13, -3, S_EXECUTING)], 30_000, Outcome.CAPTURE_ENDED),
        (TWO_ATTEMPTS[:1], 30_000, Outcome.CAPTURE_ENDED),
        (TWO_ATTEMPTS[:1], 180_009, Outcome.CAPTURE_ENDED),
        (TWO_ATTEMPTS[:1], 180_011, Outcome.UNANSWERED),
    ],
)
def test_a_client_gives_up_a_few_timeouts_after_its_last_attempt(
    lines: list[tuple[object, ...]], ends: float, outcome: Outcome
) -> None:
    """The capture reaches so far because of another client."""
    script = Script()
    play(script, [*SET_POINTS, *lines])
    other = script.client(port=50002)
    other.ask(ends, 1, 0, MOVE)
    other.reply(ends, 1)
    calls = calls_of(script.track())
    assert [call.outcome for call in calls if call.request.item.serial == 2] == [outcome]


def test_a_call_that_was_retried_is_given_out_before_a_single_attempt_would_be() -> None:
    script = Script()
    play(script, TWO_ATTEMPTS)
    play(script, [(6000, 1, 0, MOVE)])
    assert summaries(script.track())[0] == "1: >1 >>2 unanswered, unanswered"


THREE: list[tuple[object, ...]] = [(10, 2, 0, OTHER), (18, 3, 2, OTHER), (26, 4, 2, OTHER)]


@pytest.mark.parametrize(
    ("lines", "summary"),
    [
        ([*THREE, (45, -4, 0, POSE)], ">3 >>4 >>5 late<6 unanswered, reply late"),
        ([*THREE, (41, -4, 0, POSE)], ">3 >>4 >>5 <6 answered, cannot tell"),
        ([*THREE, (45, -4, 0, POSE), (150, 5, 2, OTHER), (151, -5, 0, POSE)], ""),
        ([*THREE, (27, -4, S_EXECUTING), (45, -4, 0, POSE)], ">3 >>4 >>5 ...6 <7 answered, request lost"),
        # a notice that arrives after the reply did not make the client wait longer for it
        ([*THREE, (45, -4, 0, POSE), (46, -3, S_EXECUTING)], ">3 >>4 >>5 late<6 ...7 unanswered, reply late"),
        ([(10, 2, 0, OTHER), (45, -2, 0, POSE)], ">3 <4 answered, answered"),
        # without the shortest timeout of all clients, an attempt that a network held back would show 0.1 ms
        ([(10, 2, 0, OTHER), (10.1, 3, 2, OTHER), (13, -3, 0, POSE)], ">3 >>4 <5 answered, cannot tell"),
        # two attempts, 8 ms apart each, of which the capture lacks one
        ([(10, 2, 0, OTHER), (26, 4, 2, OTHER), (45, -4, 0, POSE)], ">3 >>4 late<5 unanswered, reply late"),
    ],
)
def test_a_reply_long_after_the_timeout_is_late(lines: list[tuple[object, ...]], summary: str) -> None:
    script = Script()
    play(script, [*SET_POINTS, *lines, (200, 9, 0, MOVE), (201, -9, 0, POSE)])
    calls = calls_of(script.track())
    found = summaries([calls[1]])[0].partition(": ")[2]
    if summary:
        assert found == summary
    else:  # a client that retries after the reply had not given up
        assert found == ">3 >>4 >>5 lost<6 >>7 <8 answered, reply lost"


def test_a_late_reply_says_when_the_client_gave_up() -> None:
    script = Script()
    play(script, [*THREE, (45, -4, 0, POSE)])
    (call,) = calls_of(script.track())
    assert (call.abandoned_at, call.gave_up_inferred) == (START + 34 * MS, True)
    assert (call.outcome, call.verdict) == (Outcome.UNANSWERED, CallVerdict.REPLY_LATE)


def test_earlier_calls_of_a_kind_show_a_longer_timeout() -> None:
    script = Script()
    lines: list[tuple[object, ...]] = []
    for number in range(3):
        serial = 10 + 10 * number
        at = 100 * number
        lines += [
            (at, serial, 0, OTHER),
            (at + 10, serial + 1, serial, OTHER),
            (at + 11, -serial - 1, 0, POSE),
        ]
    lines += [(400, 50, 0, OTHER), (402, 51, 50, OTHER), (410, -51, 0, POSE)]
    play(script, lines)
    assert calls_of(script.track())[3].outcome is Outcome.ANSWERED


def test_distances_count_attempts_that_were_not_captured() -> None:
    script = Script()
    play(script, [(0, 20, 0, MOVE), (8, 21, 20, MOVE), (32, 24, 20, MOVE)])
    (call,) = calls_of(script.track())
    assert attempt_distances(call) == [8 * MS, 8 * MS]
    assert gives_up_at(call) == START + 82 * MS
    assert not waits_in_vain(call, START + 49 * MS)
    assert waits_in_vain(call, START + 50 * MS)


def test_a_single_attempt_shows_no_timeout() -> None:
    script = Script()
    script.client(transport=Transport.TCP).ask(0, 1, 0, MOVE)
    (call,) = calls_of(script.track())
    assert (attempt_distances(call), gives_up_at(call)) == ([], 0)
    assert not waits_in_vain(call, START + 10**15)


def test_a_client_waits_in_vain_after_three_timeouts() -> None:
    script = Script()
    play(script, [(0, 20, 0, MOVE), (100, 21, 20, MOVE)])
    (call,) = calls_of(script.track())
    assert not waits_in_vain(call, START + 300 * MS - 1)
    assert waits_in_vain(call, START + 300 * MS)


@pytest.mark.parametrize(("others", "outcome"), [(63, Outcome.ANSWERED), (64, Outcome.UNANSWERED)])
def test_the_timeouts_of_64_kinds_are_remembered(others: int, outcome: Outcome) -> None:
    """The first calls of a kind show a timeout of 50 ms, and the last one a timeout of 2 ms."""
    lines: list[tuple[object, ...]] = []
    commands = ["CurJnt"] * 3 + [f"Other{number}" for number in range(others)]
    for number, command in enumerate(commands):
        at, serial = 200 * number, 1 + 2 * number
        lines += [(at, serial, 0, execute(command)), (at + 50, serial + 1, serial, execute(command))]
        lines += [(at + 51, -serial - 1)]
    at = 200 * len(commands)
    lines += [(at, 901, 0, execute("CurJnt")), (at + 2, 902, 901, execute("CurJnt")), (at + 92, -902)]
    script = Script()
    play(script, lines)
    assert calls_of(script.track())[-1].outcome is outcome
