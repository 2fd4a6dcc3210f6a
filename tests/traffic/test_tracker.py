"""When calls settle, in which order, and what bounds them."""

from __future__ import annotations

import gc

import pytest

from bcapscope.protocol.codec.frame import Malformed
from bcapscope.traffic import tracker as tracker_module
from bcapscope.traffic.call import PairingResult, StrayReply
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.frame_index import FrameIndex
from bcapscope.traffic.joining.joined_observation import join_sightings
from bcapscope.traffic.observation import Direction, Observation, Transport
from bcapscope.traffic.tracker import MAX_OPEN, Tracker
from tests.samples.problems import problem_of
from tests.traffic.playbook import (
    MOVE,
    MS,
    OTHER,
    POSE,
    START,
    Client,
    Script,
    calls_of,
    strays_of,
    summaries,
)


def test_bytes_that_are_no_frame_belong_to_no_call() -> None:
    script = Script()
    client = script.client()
    client.see(0, Direction.REQUEST, Malformed(b"x", (problem_of(0, "soh", "no frame"),)))
    assert script.track() == []


def test_calls_settle_by_time_alone() -> None:
    script = Script()
    client = script.client()
    answered = client.ask(0, 1, 1, MOVE)
    reply = client.reply(1, 1)
    tracker = Tracker()
    assert list(tracker.observe(answered)) == []
    assert [call.number for call in tracker.open_calls] == [1]
    assert tracker.open_calls[0].outcome is Outcome.CAPTURE_ENDED
    assert list(tracker.observe(reply)) == []
    assert list(tracker.expire(reply.time + 5000 * MS - 1)) == []
    assert summaries(tracker.expire(reply.time + 5000 * MS)) == ["1: >1 <2 answered, answered"]
    assert tracker.open_calls == []
    silent = client.ask(6000, 2, 2, MOVE)
    assert list(tracker.observe(silent)) == []
    assert list(tracker.expire(silent.time + 180_000 * MS - 1)) == []
    assert summaries(tracker.expire(silent.time + 180_000 * MS)) == ["2: >3 unanswered, unanswered"]


def test_a_call_stays_open_while_the_reply_to_the_next_call_may_have_overtaken_its_own() -> None:
    script = Script()
    client = script.client()
    tracker = Tracker()
    for ms, serial in ((0, 1), (8, 2), (16, 3), (24, 4)):
        tracker.observe(client.ask(ms, serial, serial, MOVE if serial % 2 else OTHER))
        if serial == 2:
            tracker.observe(client.reply(9, 2))
    reply = client.reply(1000, 4)
    tracker.observe(reply)
    before = summaries(tracker.expire(reply.time + 100 * MS - 1))
    assert [each[:2] for each in before] == ["1:", "2:"]
    after = summaries(tracker.expire(reply.time + 100 * MS))
    assert [each[:2] for each in after] == ["3:"]


def _two_calls() -> tuple[Client, Tracker, Observation]:
    """Observe a call, its reply and the client's next call. Return the reply, too."""
    client, tracker = Script().client(), Tracker()
    tracker.observe(client.ask(0, 1, 1, MOVE))
    reply = client.reply(1, 1)
    tracker.observe(reply)
    tracker.observe(client.ask(8, 2, 2, OTHER))
    return client, tracker, reply


def test_every_50_ms_a_frame_completes_the_calls_that_have_settled() -> None:
    client, tracker, reply = _two_calls()
    checked = reply.time + 100 * MS - 1
    assert list(tracker.expire(checked)) == []
    early, due = client.reply(150, 2), client.ask(151, 3, 3, MOVE)
    assert list(tracker.observe(early._replace(time=checked + 50 * MS - 1))) == []
    found = tracker.observe(due._replace(time=checked + 50 * MS))
    assert summaries(found) == ["1: >1 <2 answered, answered"]


def test_a_call_settles_soon_once_client_and_server_go_on() -> None:
    client, tracker, reply = _two_calls()
    assert list(tracker.expire(reply.time + 100 * MS - 1)) == []
    assert summaries(tracker.expire(reply.time + 100 * MS)) == ["1: >1 <2 answered, answered"]
    gone_on = client.ask(200, 3, 3, MOVE)
    tracker.observe(gone_on)
    tracker.observe(client.reply(201, 3))
    assert list(tracker.expire(gone_on.time + 1000 * MS - 1)) == []
    assert summaries(tracker.expire(gone_on.time + 1000 * MS)) == ["2: >3 unanswered, unanswered"]


def test_a_call_that_was_retried_settles_5_s_after_its_last_attempt() -> None:
    client, tracker = Script().client(), Tracker()
    tracker.observe(client.ask(0, 1, 0, MOVE))
    last = client.ask(20, 2, 1, MOVE)
    tracker.observe(last)
    assert list(tracker.expire(last.time + 5000 * MS - 1)) == []
    assert summaries(tracker.expire(last.time + 5000 * MS)) == ["1: >1 >>2 unanswered, unanswered"]


def test_a_call_that_the_server_may_be_at_settles_later() -> None:
    script = Script()
    client = script.client()
    tracker = Tracker()
    tracker.observe(client.ask(0, 1, 1, MOVE))
    gone_on = client.ask(200, 2, 2, MOVE)
    tracker.observe(gone_on)
    assert list(tracker.expire(gone_on.time + 30_000 * MS - 1)) == []
    assert summaries(tracker.expire(gone_on.time + 30_000 * MS)) == ["1: >1 unanswered, unanswered"]


def test_four_clients_that_get_no_answer_are_followed() -> None:
    script = Script()
    clients = [script.client(50001 + number) for number in range(4)]
    tracker = Tracker()
    settled: list[PairingResult] = []
    for client in clients:
        settled += tracker.observe(client.ask(0, 1, 1, MOVE))
        settled += tracker.observe(client.reply(1, 1))
    for number in range(2, 3001):
        for client in clients:
            settled += tracker.observe(client.ask(2 * number, number, number, MOVE))
    calls = calls_of(settled)
    assert {call.outcome for call in calls if call.request.item.serial > 1} == {Outcome.UNANSWERED}
    assert len(calls) + len(tracker.open_calls) == 12_000


def test_calls_of_a_conversation_come_in_order_and_others_do_not_wait() -> None:
    script = Script()
    slow, quick = script.client(1), script.client(2)
    tracker = Tracker()
    tracker.observe(slow.ask(0, 1, 1, MOVE))
    settled: list[PairingResult] = []
    for step in range(100):
        settled += tracker.observe(quick.ask(8 * step, 1 + step, 1 + step, MOVE))
        settled += tracker.observe(quick.reply(8 * step + 1, 1 + step))
    assert len(settled) > 80
    assert {call.conversation for call in calls_of(settled)} == {quick.conversation}
    settled += tracker.close()
    assert sorted(call.number for call in calls_of(settled)) == list(range(1, 102))
    for client in (slow, quick):
        numbers = [call.number for call in calls_of(settled) if call.conversation is client.conversation]
        assert numbers == sorted(numbers)


def test_a_clock_that_is_set_back_stops_nothing() -> None:
    script = Script()
    client = script.client()
    for step in range(1, 60):
        client.ask(3_600_000 - 120_000 * step, step, step, MOVE)
        client.reply(3_600_000 - 120_000 * step + 1, step)
    calls = calls_of(script.track())
    assert [call.verdict for call in calls] == [CallVerdict.ANSWERED] * 59


def test_a_call_takes_as_much_memory_in_whichever_order_its_attempts_come() -> None:
    found = []
    for first, second in (((5, 0), (6, 5)), ((6, 5), (5, 0))):
        script = Script()
        client = script.client()
        client.ask(0, *first, MOVE)
        client.ask(1, *second, MOVE)
        client.reply(2, 6, 0, 0, POSE)
        (call,) = calls_of(script.track())
        assert (len(call.attempts), call.request.item.serial) == (2, 5)
        found.append(call.memory_bytes)
    assert found[0] == found[1] > sum(len(observation.item.raw) for observation in script.seen)


def frame_indexes() -> int:
    gc.collect()
    return sum(isinstance(each, FrameIndex) for each in gc.get_objects())


def test_nothing_is_kept_of_retries_that_have_settled() -> None:
    script = Script()
    client = script.client()
    for start in range(0, 200_000, 1000):
        client.ask(start, 1, 0, MOVE)
        client.ask(start + 2, 2, 1, MOVE)
        client.reply(start + 3, 2, 0, 0, POSE)
    before, tracker = frame_indexes(), Tracker()
    settled = [item for observation in script.seen for item in tracker.observe(observation)]
    assert len(settled) > 180
    assert frame_indexes() - before < 20


def test_open_calls_are_bounded_and_the_busiest_makes_room() -> None:
    script = Script()
    patient, flood = script.client(1), script.client(2)
    tracker = Tracker()
    tracker.observe(patient.ask(0, 1, 1, MOVE))
    settled: list[PairingResult] = []
    for step in range(3 * MAX_OPEN):
        settled += tracker.observe(flood.ask(0.001 * step, step % 65536, step % 65536, MOVE))
        assert len(tracker.open_calls) <= MAX_OPEN if step % 1000 == 0 else True
    assert patient.conversation in {call.conversation for call in tracker.open_calls}
    settled += tracker.close()
    assert [call.number for call in calls_of(settled) if call.conversation is flood.conversation] == list(
        range(2, 3 * MAX_OPEN + 2)
    )


def test_conversations_are_bounded_and_the_silent_one_goes_first() -> None:
    script = Script()
    tracker = Tracker()
    settled: list[PairingResult] = []
    clients = [script.client(port) for port in range(MAX_CONVERSATIONS + 2)]
    for step, client in enumerate(clients):
        settled += tracker.observe(client.ask(0.001 * step, 1, 1, MOVE))
    assert [call.conversation for call in calls_of(settled)] == [
        client.conversation for client in clients[:2]
    ]
    assert {call.outcome for call in calls_of(settled)} == {Outcome.NOT_FOLLOWED}
    assert len(tracker.open_calls) == MAX_CONVERSATIONS


def test_a_call_that_is_let_go_is_not_said_to_be_unanswered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker_module, "MAX_OPEN", 4)
    script = Script()
    client, other = script.client(1), script.client(2)
    client.ask(0, 1, 1, MOVE)
    client.reply(1, 1)
    for serial in range(2, 6):
        client.ask(serial, serial, serial, MOVE)
    for serial in (2, 4, 5, 77):
        client.reply(7, serial)
    other.ask(8, 1, 1, MOVE)
    other.reply(9, 78)
    settled = script.track()
    assert summaries(settled) == [
        "1: >1 <2 answered, answered",
        "2: >3 not_followed, not followed",
        "3: >4 not_followed, not followed",
        "stray 7 of 2",
        "stray 10 of None",
        "stray 12 of None",
        "4: >5 <8 answered, answered",
        "5: >6 <9 answered, answered",
        "6: >11 capture_ended, capture ended",
    ]
    assert [call.surely_unanswered for call in calls_of(settled)[1:3]] == [False, False]
    assert [stray.may_answer_evicted for stray in strays_of(settled)] == [True, True, False]


def test_what_comes_for_a_conversation_that_was_let_go_may_answer_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker_module, "MAX_CONVERSATIONS", 1)
    script = Script()
    done, busy, other = (script.client(port) for port in (1, 2, 3))
    done.ask(0, 1, 1, MOVE)
    done.reply(1, 1)
    busy.ask(7000, 1, 1, MOVE)
    done.reply(7001, 2)
    busy.reply(7002, 1)
    other.ask(7003, 1, 1, MOVE)
    other.reply(7004, 1)
    settled = script.track()
    assert [stray.may_answer_evicted for stray in strays_of(settled)] == [False, True]
    assert [str(call.outcome) for call in calls_of(settled)] == ["answered", "not_followed", "answered"]


def test_a_late_reply_to_a_call_that_was_not_let_go_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker_module, "MAX_OPEN", 2)
    script = Script()
    client = script.client()
    for serial in range(1, 4):
        client.ask(serial, serial, serial, MOVE)
    client.reply(4, 3)
    client.ask(20_000, 5, 5, MOVE)
    client.reply(20_001, 3, 0, 0x600B)
    assert [(stray.call_number, stray.may_answer_evicted) for stray in strays_of(script.track())] == [
        (3, False)
    ]


@pytest.mark.parametrize(
    ("ends", "outcome"),
    [
        ([(Direction.RESPONSE, False)], Outcome.UNANSWERED),
        ([(Direction.REQUEST, True)], Outcome.UNANSWERED),
        ([(Direction.REQUEST, False)], Outcome.CAPTURE_ENDED),
        ([(Direction.REQUEST, False)] * 2, Outcome.CAPTURE_ENDED),
        ([(Direction.REQUEST, False), (Direction.RESPONSE, False)], Outcome.UNANSWERED),
        ([(Direction.REQUEST, False), (Direction.REQUEST, True)], Outcome.UNANSWERED),
    ],
)
def test_no_reply_comes_over_a_connection_that_is_gone(
    ends: list[tuple[Direction, bool]], outcome: Outcome
) -> None:
    script = Script()
    asked = script.client(transport=Transport.TCP).ask(0, 1, 1, MOVE)
    for by, reset in ends:
        asked.flow.conversation.record_end(by, reset, asked.time + MS)
    (call,) = calls_of(script.track())
    assert call.outcome is outcome


def test_a_conversation_that_was_closed_may_begin_again() -> None:
    client, tracker = Script().client(), Tracker()
    tracker.observe(client.ask(0, 1, 0, MOVE))
    assert len(tracker.close_conversation(client.conversation)) == 1
    tracker.observe(client.ask(10, 2, 0, MOVE))
    assert [call.number for call in tracker.open_calls] == [2]


def test_a_request_of_a_proxy_may_be_the_first_frame_of_a_conversation() -> None:
    """The conversation that has been silent for the longest time makes room for it."""
    script, tracker = Script(), Tracker()
    requests = [script.client(port).ask(port, 1, 0, MOVE) for port in range(MAX_CONVERSATIONS + 1)]
    for request in requests[:-1]:
        assert list(tracker.observe(request)) == []
    own = join_sightings(None, requests[-1], requests[-1].flow, is_missed=True)
    (evicted,) = calls_of(tracker.observe_joined(own))
    assert evicted.request.number == requests[0].number


def test_time_starts_anywhere() -> None:
    script = Script()
    client = script.client()
    client.ask(-START / MS, 1, 1, MOVE)
    client.reply(-START / MS, 1)
    assert summaries(script.track()) == ["1: >1 <2 answered, answered"]


def test_the_open_calls_of_a_client_that_is_gone_are_given_out_and_it_is_forgotten() -> None:
    script = Script()
    client, other = script.client(), script.client(50002)
    tracker = Tracker()
    first, second = client.ask(0, 1, 1, MOVE), other.ask(1, 1, 1, MOVE)
    tracker.observe(first)
    tracker.observe(second)
    gone = first.flow.conversation
    assert [call.number for call in calls_of(tracker.close_conversation(gone))] == [1]
    assert [call.number for call in tracker.open_calls] == [2]
    assert list(tracker.close_conversation(gone)) == []
    late = client.reply(2, 1)
    (stray,) = tracker.observe(late)
    assert isinstance(stray, StrayReply)
    assert stray.call_number is None


@pytest.mark.parametrize(("spare", "evicted"), [(0, 0), (-1, 2)])
def test_calls_are_evicted_beyond_the_memory_limit(
    spare: int, evicted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = Script()
    client = script.client()
    for serial in range(1, 4):
        client.ask(serial, serial, 0, MOVE)
    size = sum(len(observation.item.raw) for observation in script.seen)
    monkeypatch.setattr(tracker_module, "MAX_BYTES", size + spare)
    tracker = Tracker()
    assert sum(len(tracker.observe(observation)) for observation in script.seen) == evicted


def test_the_conversation_with_the_most_bytes_is_the_first_to_lose_calls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tracker_module, "MAX_BYTES", 1 << 14)
    script = Script()
    patient, flood = script.client(1), script.client(2)
    tracker = Tracker()
    tracker.observe(patient.ask(0, 1, 1, MOVE))
    settled: list[PairingResult] = []
    for step in range(1, 200):
        settled += tracker.observe(flood.ask(0.001 * step, step, step, MOVE))
    assert {call.conversation for call in calls_of(settled) if call.evicted} == {flood.conversation}
    assert patient.conversation in {call.conversation for call in tracker.open_calls}
