"""Handles that a controller gave show what the capture lacks."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import Variant
from bcapscope.traffic import handle_sequence
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_sequence import HandleSequence
from tests.traffic.playbook import CONNECT, GET_ROBOT, START_SERVICE, Script, calls_of, execute, i4, text

UNKNOWN = 9999, (i4(1),)
OPEN_CONTROLLER = CONNECT, (text(""), text(""), text(""), text(""))
OPEN_ROBOT = GET_ROBOT, (i4(1), text(""), text(""))
FAILED = 0x80004005

Step = tuple[tuple[int, tuple[Variant, ...]], int | None, int]
"""A request, the handle in its reply (None: no result), and the result code."""


def answered(question: tuple[int, tuple[Variant, ...]], handle: int | None = None, code: int = 0) -> Step:
    return question, handle, code


def calls(*steps: Step) -> list[Call]:
    """Return one call per step, each answered."""
    script = Script()
    client = script.client()
    for number, (question, handle, code) in enumerate(steps):
        client.ask(10 * number, number + 1, 0, question)
        client.reply(10 * number + 1, number + 1, 0, code, *(() if handle is None else (i4(handle),)))
    return calls_of(script.track())


def unanswered(question: tuple[int, tuple[Variant, ...]]) -> Call:
    script = Script()
    script.client().ask(0, 1, 0, question)
    (call,) = calls_of(script.track())
    return call


def sequence(*opened: Step) -> HandleSequence:
    """Return a sequence that has seen the start of the session and what was opened."""
    found = HandleSequence()
    for call in calls(answered(START_SERVICE), *opened):
        found.add_call(call)
    return found


def test_an_accepted_handle_that_no_reply_holds_proves_a_reply() -> None:
    seen = sequence(answered(OPEN_CONTROLLER, 1))
    assert seen.prove_reply(unanswered(OPEN_ROBOT), calls(answered(execute("Speed", 2))))


@pytest.mark.parametrize(
    "later",
    [
        answered(execute("Speed", 1)),  # given already
        answered(execute("Speed", 2), code=FAILED),  # not accepted
        answered(execute("Speed", 0)),  # no handle
        answered(execute("Speed", -1)),
        answered(OPEN_ROBOT, 2),  # takes a controller's handle, not a robot's
        answered(UNKNOWN),
    ],
)
def test_other_calls_prove_nothing(later: Step) -> None:
    seen = sequence(answered(OPEN_ROBOT, 1))
    assert not seen.prove_reply(unanswered(OPEN_ROBOT), calls(later))


def test_a_handle_that_a_later_reply_holds_proves_nothing() -> None:
    seen = sequence()
    assert not seen.prove_reply(
        unanswered(OPEN_ROBOT), calls(answered(OPEN_ROBOT, 2), answered(execute("Speed", 2)))
    )


def test_what_follows_a_new_session_proves_nothing() -> None:
    seen = sequence()
    later = calls(answered(START_SERVICE), answered(execute("Speed", 2)))
    assert not seen.prove_reply(unanswered(OPEN_ROBOT), later)
    assert seen.prove_reply(unanswered(OPEN_ROBOT), later[1:])


@pytest.mark.parametrize("call", [UNKNOWN, execute("Speed")])
def test_only_a_call_that_opens_an_object_gets_a_handle(call: tuple[int, tuple[Variant, ...]]) -> None:
    assert not sequence().prove_reply(unanswered(call), calls(answered(execute("Speed", 2))))


def test_without_the_start_of_the_session_nothing_is_proved() -> None:
    assert not HandleSequence().prove_reply(unanswered(OPEN_ROBOT), calls(answered(execute("Speed", 2))))


@pytest.mark.parametrize(("objects", "is_proved"), [(3, True), (4, False)])
def test_of_too_many_objects_nothing_is_proved(
    monkeypatch: pytest.MonkeyPatch, objects: int, is_proved: bool
) -> None:
    monkeypatch.setattr(handle_sequence, "MAX_OBJECTS", 3)
    seen = sequence(*(answered(OPEN_ROBOT, handle) for handle in range(1, objects + 1)))
    assert seen.prove_reply(unanswered(OPEN_ROBOT), calls(answered(execute("Speed", 99)))) is is_proved


def retried(retries: int, handle: int) -> Call:
    """Return a call that opens a robot with some retries, whose reply holds `handle`."""
    script = Script()
    client = script.client()
    client.ask(0, 10, 0, OPEN_ROBOT)
    for number in range(1, retries + 1):
        client.ask(100 * number, 10 + number, 10, OPEN_ROBOT)
    client.reply(100 * retries + 50, 10 + retries, 0, 0, i4(handle))
    (call,) = calls_of(script.track())
    return call


@pytest.mark.parametrize(
    ("retries", "handle", "skipped"),
    [(2, 6, 0), (2, 7, 1), (2, 8, 2), (2, 9, 0), (0, 7, 0), (2, 4, 0)],
)
def test_a_retried_call_may_skip_a_handle_per_retry(retries: int, handle: int, skipped: int) -> None:
    seen = sequence(answered(OPEN_CONTROLLER, 5))
    call = retried(retries, handle)
    seen.add_call(call)
    assert call.skipped_handles == skipped


def test_handles_start_anew_with_the_session() -> None:
    seen = sequence(answered(OPEN_CONTROLLER, 5))
    seen.add_call(calls(answered(START_SERVICE))[0])
    call = retried(2, 7)
    seen.add_call(call)
    assert call.skipped_handles == 0
    after = retried(2, 9)
    seen.add_call(after)
    assert after.skipped_handles == 1
