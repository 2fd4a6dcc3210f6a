"""The table of states is complete, and pairing does what it says."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bcapscope.traffic.call import Call, CallState, FrameRole
from bcapscope.traffic.conversation_pairing import ConversationPairing
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.pairing_states import AWAITING_REPLY, TRANSITIONS, CallEvent, copy_event
from tests.traffic.playbook import MOVE, OTHER, POSE, S_EXECUTING, START, Script, r8s

OPEN = (CallState.WAITING, CallState.EXECUTING, CallState.ANSWERED, CallState.ABANDONED)
ENDS = (CallEvent.EXPIRY, CallEvent.EVICTION)


class Stage:
    """One call with serials 10 (first attempt), 11 (not sent yet) and 12 (latest attempt)."""

    def __init__(self, *, first_attempt: bool = True) -> None:
        self.client = Script().client()
        self.pairing = ConversationPairing(self.client.conversation, latest_evicted=0)
        self.started = 0
        if first_attempt:
            self.add(self.client.ask(0, 10, 0, MOVE))
        self.add(self.client.ask(4, 12, 10, MOVE))
        self.call: Call = self.pairing.open_calls[0]

    def add(self, seen: Observation) -> Observation:
        if seen.flow.direction is Direction.REQUEST:
            self.started += self.pairing.add_request(seen, seen.item, self.started + 1)  # type: ignore[arg-type]  # item is a frame
        else:
            self.pairing.add_reply(seen, seen.item)  # type: ignore[arg-type]  # likewise
        return seen


BRING_TO: dict[CallState, Callable[[Stage], object]] = {
    CallState.WAITING: lambda stage: None,
    CallState.EXECUTING: lambda stage: stage.add(stage.client.reply(5, 12, 0, S_EXECUTING)),
    CallState.ANSWERED: lambda stage: stage.add(stage.client.reply(5, 12, 0, 0, POSE)),
    CallState.ABANDONED: lambda stage: stage.add(stage.client.ask(7, 20, 0, OTHER)),
    CallState.UNANSWERED: lambda stage: list(stage.pairing.pop_settled(START + 10**12)),
}


def later_retry(stage: Stage) -> Observation:
    stage.add(stage.client.ask(5.5, 21, 0, OTHER))
    return stage.add(stage.client.ask(20, 13, 10, MOVE))


def captured_again(stage: Stage) -> Observation:
    copied = stage.client.ask(4.2, 12, 10, MOVE)
    return stage.add(copied)


def undelivered_reply(stage: Stage) -> Observation:
    seen = stage.client.reply(20, 12, 0, 0, POSE)
    stage.pairing.add_undelivered_reply(seen, seen.item)  # type: ignore[arg-type]  # item is a frame
    return seen


MAKE_HAPPEN: dict[CallEvent, Callable[[Stage], Observation | None]] = {
    CallEvent.RETRY: lambda stage: stage.add(stage.client.ask(20, 13, 10, MOVE)),
    CallEvent.LATER_RETRY: later_retry,
    CallEvent.OVERTAKEN_RETRY: lambda stage: stage.add(stage.client.ask(20, 11, 10, MOVE)),
    CallEvent.FIRST_ATTEMPT: lambda stage: stage.add(stage.client.ask(20, 10, 0, MOVE)),
    CallEvent.COPY: lambda stage: stage.add(stage.client.ask(20, 12, 10, MOVE)),
    CallEvent.CAPTURED_AGAIN: captured_again,
    CallEvent.NOTICE: lambda stage: stage.add(stage.client.reply(20, 12, 0, S_EXECUTING)),
    CallEvent.REPLY: lambda stage: stage.add(stage.client.reply(20, 12, 0, 0, r8s(9.0))),
    CallEvent.EARLIER_REPLY: lambda stage: stage.add(stage.client.reply(20, 10, 0, 0, r8s(8.0))),
    CallEvent.OVERDUE_REPLY: lambda stage: (list(stage.pairing.pop_settled(START + 10**12)), None)[1],
    CallEvent.UNDELIVERED_REPLY: undelivered_reply,
    CallEvent.NEXT_CALL: lambda stage: (stage.add(stage.client.ask(20, 22, 0, OTHER)), None)[1],
    CallEvent.EXPIRY: lambda stage: (list(stage.pairing.pop_settled(START + 10**12)), None)[1],
    CallEvent.EVICTION: lambda stage: (list(stage.pairing.evict_oldest(1)), None)[1],
}


@pytest.mark.parametrize(("state", "event"), TRANSITIONS, ids=lambda each: str(each).replace(" ", "-"))
def test_pairing_follows_the_table(state: CallState, event: CallEvent) -> None:
    stage = Stage(first_attempt=event is not CallEvent.FIRST_ATTEMPT)
    if event is CallEvent.OVERDUE_REPLY:
        stage.add(stage.client.reply(40, 12, 0, 0, POSE))
    else:
        BRING_TO[state](stage)
    call, before = stage.call, stage.call.reply
    assert call.state is state
    seen = MAKE_HAPPEN[event](stage)
    expected = TRANSITIONS[state, event]
    assert call.state is expected.state
    if seen is None:
        assert expected.role is None
        gives_up = event in (CallEvent.NEXT_CALL, CallEvent.OVERDUE_REPLY)
        assert bool(call.abandoned_at) is (gives_up or state is CallState.ABANDONED)
    else:
        assert {each.role for each in call.frames if each.observation.number == seen.number} == {
            expected.role
        }
    if expected.reply_becomes is not None:
        assert call.reply is None
        replies = [each.role for each in call.frames if each.observation is before]
        assert replies == [expected.reply_becomes]
    elif expected.role is not FrameRole.REPLY:
        assert call.reply is before


def test_every_frame_is_expected_while_a_call_is_open() -> None:
    frames = set(CallEvent) - {CallEvent.NEXT_CALL, CallEvent.OVERDUE_REPLY, *ENDS}
    for state in OPEN:
        missing = {event for event in frames if (state, event) not in TRANSITIONS}
        # Only the newest call gets a RETRY, and a client abandons a call with a newer one.
        assert missing == ({CallEvent.RETRY} if state is CallState.ABANDONED else set())
        assert all((state, event) in TRANSITIONS for event in ENDS)


def test_a_call_that_was_returned_gets_no_more_frames() -> None:
    for (state, _), transition in TRANSITIONS.items():
        if state not in OPEN:
            assert transition.role is None
            assert transition.state not in OPEN


def test_frames_leave_a_call_open_and_ends_do_not() -> None:
    for (_, event), transition in TRANSITIONS.items():
        assert (transition.state in OPEN) is (event not in ENDS and transition.state is not CallState.SETTLED)
        assert (transition.role is None) is (event in (CallEvent.NEXT_CALL, CallEvent.OVERDUE_REPLY, *ENDS))


@pytest.mark.parametrize("retries", [False, True])
def test_the_fast_way_of_a_plain_reply_ends_in_the_same_state(retries: bool) -> None:
    stage = Stage(first_attempt=retries)
    stage.add(stage.client.reply(6, 12, 0, 0, POSE))
    assert stage.call.state is TRANSITIONS[CallState.WAITING, CallEvent.REPLY].state
    assert stage.call.reply is not None
    (settled,) = stage.pairing.pop_settled(START + 10**12)
    assert settled.state is TRANSITIONS[CallState.ANSWERED, CallEvent.EXPIRY].state


@pytest.mark.parametrize(
    ("later", "event"),
    [
        (0, CallEvent.CAPTURED_AGAIN),
        (1_000_000, CallEvent.CAPTURED_AGAIN),
        (1_000_001, CallEvent.COPY),
    ],
)
def test_a_copy_within_one_millisecond_was_captured_again(later: int, event: CallEvent) -> None:
    assert copy_event(START + later, START) is event


def test_a_client_waits_in_the_states_in_which_it_can_begin_a_call() -> None:
    waiting = {CallState.WAITING, CallState.EXECUTING, CallState.UNANSWERED}
    assert waiting == AWAITING_REPLY
