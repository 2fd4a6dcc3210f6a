"""Conversations that were captured on both legs of a proxy are one."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.joining import joiner as joiner_module
from bcapscope.traffic.joining.frame_sample import ends_of
from bcapscope.traffic.joining.joined_observation import CapturePlace, JoinedObservation, sighting_numbers
from bcapscope.traffic.joining.joiner import HELD_UNANSWERED_NS, Joiner
from bcapscope.traffic.joining.place_merger import CapturedTwins, CaptureSide, Coverage
from bcapscope.traffic.observation import Direction, Endpoint, Observation, Transport
from bcapscope.traffic.pipeline import CallCollector, Pipeline
from tests.traffic.joining.two_places import START_SERVICE, ProxiedClient, ProxiedScript
from tests.traffic.playbook import MOVE, MS, OTHER, POSE, S_EXECUTING, START, Script, execute, i4

TRANSPORTS = [Transport.UDP, Transport.TCP]


def joined(observations: list[Observation], only: CapturePlace | None = None) -> list[Observation]:
    joiner = Joiner(only=only)
    due = [each for seen in observations for each in joiner.add(seen)]
    return [*due, *joiner.close()]


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_call_on_both_legs_is_one_call_of_the_client(transport: Transport) -> None:
    script = ProxiedScript()
    client = script.proxied_client(transport=transport)
    client.call(0, 1, START_SERVICE)
    client.calls(8, 20, MOVE, 2)
    calls = script.calls()
    assert len(calls) == 21
    assert {call.conversation.client for call in calls} == {Endpoint("10.0.0.2", 50001)}
    assert {call.verdict for call in calls} == {CallVerdict.ANSWERED}
    assert {call.latency for call in calls} == {MS}


def test_every_observation_comes_out_once_in_order_of_time() -> None:
    script = ProxiedScript()
    script.proxied_client().calls(0, 30, MOVE)
    script.proxied_client(50002).calls(1, 30, OTHER)
    alone = script.client(50003)
    for serial in range(1, 30):
        alone.ask(9 * serial, serial, 0, MOVE)
        alone.reply(9 * serial + 2, serial)
    seen = script.in_order()
    out = joined(seen)
    assert [each.time for each in out] == sorted(each.time for each in out)
    assert sorted(number for one in out for number in sighting_numbers(one)) == [each.number for each in seen]
    assert sum(isinstance(each, JoinedObservation) for each in out) == 120


def test_the_place_where_a_frame_was_lost_is_the_verdict() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER, lost=True)
    client.ask(108, 11, 10, OTHER)
    client.reply(109, 11)
    client.ask(200, 12, 0, MOVE)
    client.reply(201, 12, lost=True)
    client.ask(208, 13, 12, MOVE)
    client.reply(209, 13)
    client.calls(300, 2, MOVE, 20)
    calls = script.calls()
    assert len(calls) == 8
    assert [call.verdict for call in calls[4:6]] == [CallVerdict.REQUEST_LOST, CallVerdict.REPLY_LOST]
    assert [call.retries for call in calls[4:6]] == [1, 1]
    assert [len(call.lost_replies) for call in calls[4:6]] == [0, 1]


def test_the_first_loss_of_a_call_decides() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER, lost=True)
    client.ask(108, 11, 10, OTHER)
    client.reply(109, 11, lost=True)
    client.ask(116, 12, 10, OTHER)
    client.reply(117, 12)
    client.calls(300, 2, MOVE, 20)
    call = script.calls()[4]
    assert call.verdict is CallVerdict.REQUEST_LOST
    assert [each.is_request for each in call.lost_between] == [True, False]


def test_a_call_whose_only_request_was_lost_says_so() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER, lost=True)
    client.calls(3000, 2, MOVE, 20)
    call = script.calls()[4]
    assert (call.outcome, call.verdict) == (Outcome.UNANSWERED, CallVerdict.REQUEST_LOST)


def test_a_reply_that_the_proxy_delays_is_late_not_lost() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER)
    client.reply(101, 10, held=30)
    client.ask(108, 11, 10, OTHER)
    client.reply(109, 11, held=30)
    client.calls(300, 2, MOVE, 20)
    call = script.calls()[4]
    assert call.verdict is CallVerdict.REPLY_LATE
    assert call.reply is None  # the client waits for 8 ms only
    for reply in call.late_replies:
        assert isinstance(reply, JoinedObservation)
        assert reply.delay == reply.held_by_proxy == 30 * MS
    assert len(call.late_replies) == 2


def test_a_message_that_is_held_for_seconds_was_not_lost() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER, held=3000)
    client.reply(3101, 10)
    client.calls(3200, 2, MOVE, 20)
    call = script.calls()[4]
    assert (call.outcome, call.lost_between) == (Outcome.ANSWERED, ())
    request = call.request
    assert isinstance(request, JoinedObservation)
    assert request.delay == 3000 * MS


def test_what_the_proxy_sends_on_its_own_is_no_call_of_the_client() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.far.ask(2000, 10, 0, execute("GiveArm"))
    client.far.reply(2001, 10)
    assert len(script.calls()) == 4


def test_a_request_that_the_proxy_sends_twice_is_one_attempt_with_a_copy() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER)
    client.far.ask(102.3, 10, 0, OTHER)
    client.reply(101, 10)
    client.calls(300, 2, MOVE, 20)
    call = script.calls()[4]
    assert (len(call.attempts), len(call.duplicates), call.verdict) == (1, 1, CallVerdict.ANSWERED)


def test_a_reply_that_the_proxy_makes_is_accepted() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER, lost=True)
    client.near.reply(100.1, 10, 0, 0x80004005)
    client.calls(300, 2, MOVE, 20)
    call = script.calls()[4]
    assert (call.outcome, call.verdict) == (Outcome.REFUSED, CallVerdict.REFUSED)


def test_a_frame_that_the_proxy_changed_is_one_frame_as_the_client_sent_it() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.near.ask(100, 10, 0, OTHER)
    client.far.ask(100.2, 10, 0, MOVE)
    client.far.reply(101, 10, 0, 0, POSE)
    client.near.reply(101.2, 10, 0, 0, i4(7))
    client.calls(3000, 2, MOVE, 20)
    call = script.calls()[4]
    assert call.request.item.raw[9:] == client.near.ask(9999, 10, 0, OTHER).item.raw[9:]
    assert call.reply is not None
    assert call.reply.item.arguments[0].variant == i4(7)
    assert call.verdict is CallVerdict.ANSWERED


def test_a_notice_that_is_lost_still_shows_that_the_controller_works() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER)
    client.reply(101, 10, code=S_EXECUTING, lost=True)
    client.reply(140, 10)
    client.calls(300, 2, MOVE, 20)
    call = script.calls()[4]
    assert (len(call.notices), call.lost_replies, call.verdict) == (1, (), CallVerdict.ANSWERED)


def test_the_end_of_the_capture_is_no_loss() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER, lost=True)
    call = script.calls()[4]
    assert (call.outcome, call.lost_between) == (Outcome.CAPTURE_ENDED, ())


def test_two_clients_that_run_the_same_program_at_the_same_time_stay_two() -> None:
    script = Script()
    one = script.client()
    other = script.client(50002)
    other.conversation.server = Endpoint("10.0.0.9", 5007)
    for serial in range(1, 30):
        first, second = (one, other) if serial % 3 else (other, one)
        first.ask(8 * serial, serial, 0, MOVE)
        second.ask(8 * serial + 0.1, serial, 0, MOVE)
        first.reply(8 * serial + 1, serial)
        second.reply(8 * serial + 1.1, serial)
    assert not any(isinstance(each, JoinedObservation) for each in joined(script.seen))


def test_two_clients_of_one_controller_are_never_joined() -> None:
    script = Script()
    one, other = script.client(), script.client(50002)
    for serial in range(1, 30):
        one.ask(8 * serial, serial, 0, MOVE)
        other.ask(8 * serial + 0.1, serial, 0, MOVE)
        other.reply(8 * serial + 1, serial)
        one.reply(8 * serial + 1.1, serial)
    assert not any(isinstance(each, JoinedObservation) for each in joined(script.seen))


def test_many_clients_of_a_proxy_are_joined_with_their_own_legs() -> None:
    script = ProxiedScript()
    clients = [script.proxied_client(50001 + index) for index in range(5)]
    for index, client in enumerate(clients):
        client.call(index * 0.01, 1, START_SERVICE)
        client.calls(8 + index * 0.01, 20, MOVE, 2)
    calls = script.calls()
    assert len(calls) == 105
    legs = {call.conversation: call.conversation.controller_leg for call in calls}
    assert all(leg is not None and leg.client.port == one.client.port + 10_000 for one, leg in legs.items())


def test_a_conversation_without_twin_is_held_for_two_calls_only() -> None:
    script = Script()
    client = script.client()
    joiner = Joiner()
    due = []
    for serial in range(1, 4):
        due.append(len(joiner.add(client.ask(8 * serial, serial, 0, MOVE))))
        due.append(len(joiner.add(client.reply(8 * serial + 1, serial))))
    assert due == [0, 0, 0, 4, 1, 1]
    assert client.flows[next(iter(client.flows))] in joiner.passing


def test_copies_of_a_reply_are_one_call_in_the_hold_of_a_new_conversation() -> None:
    client, joiner = Script().client(), Joiner()
    seen = [client.ask(0, 1, 0, MOVE), *(client.reply(ms, 1) for ms in (1, 2, 3))]
    assert [each for frame in seen for each in joiner.add(frame)] == []
    joiner.add(client.ask(8, 2, 0, MOVE))
    assert len(joiner.add(client.reply(9, 2))) == 6


def test_silence_ends_the_hold() -> None:
    script = Script()
    collector = CallCollector()
    pipeline = Pipeline(collector, joiner=Joiner())
    seen = script.client().ask(0, 1, 0, MOVE)
    pipeline.add(seen)
    assert not pipeline.has_open_calls
    pipeline.expire(seen.time + joiner_module.HELD_UNANSWERED_NS)
    assert pipeline.has_open_calls


def test_no_call_is_complete_while_frames_before_that_time_wait() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 10, MOVE)
    client.ask(80, 11, 0, OTHER, lost=True)
    for side in (client.near, client.far):
        side.reply(90, 9)  # the network copied this frame
    seen = script.in_order()
    collector = CallCollector()
    pipeline = Pipeline(collector, joiner=Joiner())
    for each in seen:
        pipeline.add(each)
    pipeline.expire(START + 800 * MS)
    pipeline.finish()
    call = next(call for call in collector.calls if call.serials == (9,))
    assert len(call.duplicates) == 1


def test_a_clock_that_is_set_back_does_not_stop_the_output() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 10, MOVE)
    before = script.in_order()
    script.seen.clear()
    client.calls(-3_600_000, 10, OTHER, 50)
    after = [seen._replace(number=seen.number + len(before)) for seen in script.in_order()]
    out = joined([*before, *after])
    assert len(out) == 40
    assert out[-1].time < out[0].time


def test_a_clock_that_is_behind_the_clock_of_the_packets_ends_no_hold() -> None:
    script = ProxiedScript()
    script.proxied_client().calls(0, 10, MOVE)
    joiner = Joiner()
    due = []
    for seen in script.in_order():
        due += [*joiner.add(seen), *joiner.expire(seen.time - 10_000 * MS)]
    due += joiner.close()
    assert [type(each) for each in due] == [JoinedObservation] * 20


def test_both_flows_of_a_conversation_without_twin_need_the_joiner_no_longer() -> None:
    client = Script().client()
    joiner = Joiner()
    request = client.ask(0, 1, 0, MOVE)
    assert joiner.add(request) == []
    assert joiner.passing == set()
    assert joiner.expire(request.time + HELD_UNANSWERED_NS) == [request]
    assert joiner.passing == {request.flow}
    reply = client.reply(HELD_UNANSWERED_NS / MS + 1, 1)
    assert joiner.add(reply) == [reply]
    assert joiner.passing == {request.flow, reply.flow}


def test_a_client_whose_first_request_is_lost_for_seconds_is_joined_all_the_same() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.ask(0, 1, 0, START_SERVICE, lost=True)
    client.ask(7000, 2, 1, START_SERVICE)
    client.reply(7001, 2)
    client.calls(7010, 20, MOVE, 3)
    calls = script.calls()
    assert len(calls) == 21
    assert {call.conversation.client for call in calls} == {Endpoint("10.0.0.2", 50001)}
    assert calls[0].outcome is Outcome.ANSWERED
    assert (calls[0].duplicates, calls[0].captured_again) == ((), ())


@pytest.mark.parametrize(
    ("place", "near"), [(CapturePlace.CLIENT_SIDE, 43), (CapturePlace.CONTROLLER_SIDE, 2)]
)
def test_a_leg_that_is_recognised_late_is_hidden_from_then_on(place: CapturePlace, near: int) -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.ask(0, 1, 0, START_SERVICE, lost=True)
    client.ask(7000, 2, 1, START_SERVICE)
    client.reply(7001, 2)
    client.calls(7010, 20, MOVE, 3)
    out = joined(script.in_order(), place)
    assert len(out) == 43
    assert sum(each.flow.conversation is client.near.conversation for each in out) == near


@pytest.mark.parametrize("place", CapturePlace)
def test_a_direct_client_that_resembles_a_proxied_one_is_not_hidden(place: CapturePlace) -> None:
    script = ProxiedScript()
    proxied, direct = script.proxied_client(), script.client(50002)
    direct.conversation.server = Endpoint("10.0.0.9", 5007)
    for serial, ms in ((1, 0), (2, 100)):
        proxied.ask(ms, serial, 0, MOVE)
        direct.ask(ms + 10, serial, 0, MOVE)
        direct.reply(ms + 20, serial)
        proxied.reply(ms + 50, serial)
    out = joined(script.in_order(), place)
    shown = (proxied.near, proxied.far)[place]
    seen = [each.flow.conversation for each in out]
    assert seen.count(direct.conversation) == seen.count(shown.conversation) == 4
    assert len(seen) == 8


def test_one_slow_call_is_enough_where_the_proxy_is_one_host() -> None:
    script = ProxiedScript()
    script.proxied_client().call(0, 1, MOVE)
    assert len(script.calls()) == 1


def test_one_slow_call_is_enough_where_the_interfaces_are_named_as_legs() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.near.conversation.server = Endpoint("192.168.5.5", 5008)  # the proxy has two addresses
    client.call(0, 1, MOVE)
    assert len(script.calls()) == 2
    client.near.conversation.interface = "clients of 192.168.5.5:5008"
    client.far.conversation.interface = "controller 10.0.0.1:5007"
    assert len(script.calls()) == 1


def test_two_client_legs_are_never_twins() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    for leg in (client.near, client.far):
        leg.conversation.interface = "clients of 10.0.0.3:5008"
    client.calls(0, 20, MOVE)
    assert len(script.calls()) == 40


def test_the_memory_for_what_waits_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joiner_module, "MAX_WAITING", 100)
    script = Script()
    alone, busy = script.client(), script.client(50002)
    busy.ask(-20, 1, 0, MOVE)
    busy.reply(-19, 1)
    busy.ask(-10, 2, 0, MOVE)
    busy.reply(-9, 2)
    alone.ask(0, 1, 0, OTHER)
    for serial in range(3, 500):
        busy.ask(serial / 10, serial, 0, MOVE)
    joiner = Joiner()
    waiting = largest = 0
    for seen in script.seen:
        waiting += 1 - len(joiner.add(seen))
        largest = max(largest, waiting)
    assert largest <= 103
    assert waiting == 0


def test_a_reply_that_is_left_when_the_proxy_closes_the_connection_was_not_delivered() -> None:
    script = ProxiedScript()
    client = script.proxied_client(transport=Transport.TCP)
    client.calls(0, 4, MOVE)
    client.ask(100, 10, 0, OTHER)
    client.reply(101, 10, lost=True)
    closed_at = script.seen[-1].time + MS
    client.near.conversation.record_end(Direction.RESPONSE, reset=False, time=closed_at)
    call = script.calls()[4]
    assert (call.reply, len(call.lost_replies), call.outcome) == (None, 1, Outcome.UNANSWERED)


@pytest.mark.parametrize("ends_before_first_frame", [False, True])
def test_the_end_of_the_connection_is_known_although_the_other_capture_began_first(
    ends_before_first_frame: bool,
) -> None:
    script = ProxiedScript()
    client = script.proxied_client(transport=Transport.TCP)
    near, far = client.near.conversation, client.far.conversation
    twins = CapturedTwins((Coverage(START + 5 * MS), Coverage()), client_ends=ends_of(near))
    near.capture_side = CaptureSide(twins, CapturePlace.CLIENT_SIDE)
    far.capture_side = CaptureSide(twins, CapturePlace.CONTROLLER_SIDE)
    client.far.ask(0, 1, 0, MOVE)
    client.far.reply(1, 1)
    client.calls(8, 3, MOVE, 2)
    if ends_before_first_frame:
        near.record_end(Direction.REQUEST, reset=True, time=START)
    calls = script.calls()
    if not ends_before_first_frame:
        near.record_end(Direction.REQUEST, reset=True, time=START)
    (conversation,) = {call.conversation for call in calls}
    assert len(calls) == 4
    assert (conversation.client, conversation.server) == (near.client, near.server)
    assert conversation.controller_leg is far
    assert conversation.connection_end == near.connection_end is not None


def test_a_conversation_that_is_released_does_not_hide_the_requests_of_others() -> None:
    script = ProxiedScript()
    client, direct = script.proxied_client(), script.client(50002)
    client.near.ask(0, 1, 0, MOVE)
    for serial in (1, 2):
        direct.ask(serial, serial, 0, OTHER)
        direct.reply(serial + 0.5, serial)
    client.far.ask(3, 1, 0, MOVE)
    client.reply(4, 1)
    assert is_joined(script, client)


def is_joined(script: ProxiedScript, client: ProxiedClient) -> bool:
    """Return whether all that was seen of a client on its two legs comes out joined."""
    out = [each for each in joined(script.in_order()) if each.flow.conversation is client.near.conversation]
    return bool(out) and all(isinstance(each, JoinedObservation) for each in out)


def with_another_sender(script: ProxiedScript) -> None:
    script.client(50009).ask(0, 1, 0, MOVE)


def with_another_suspect(script: ProxiedScript) -> None:
    other = script.proxied_client(50009)
    other.far.ask(0, 1, 0, MOVE)  # before the other leg, so the two are no twins
    other.near.ask(1, 1, 0, MOVE)


def with_nothing_else(script: ProxiedScript) -> None:
    pass


@pytest.mark.parametrize(("limit", "expected"), [(1, False), (2, True)])
@pytest.mark.parametrize(
    ("name", "prepare"),
    [
        ("MAX_SENDERS", with_another_sender),
        ("MAX_SUSPECTS", with_another_suspect),
        ("MAX_REQUESTS", with_nothing_else),
    ],
)
def test_beyond_a_limit_the_other_leg_is_not_found(
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    prepare: Callable[[ProxiedScript], None],
    limit: int,
    expected: bool,
) -> None:
    monkeypatch.setattr(joiner_module, name, limit)
    script = ProxiedScript()
    prepare(script)
    client = script.proxied_client()
    client.call(2, 1, MOVE)
    assert is_joined(script, client) is expected


@pytest.mark.parametrize("limit", [1, 2])
def test_of_too_many_new_conversations_the_oldest_is_held_no_longer(
    monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    monkeypatch.setattr(joiner_module, "MAX_NEW", limit)
    script = Script()
    requests = [script.client(50001 + number).ask(number, 1, 0, MOVE) for number in range(limit + 1)]
    joiner = Joiner()
    assert [joiner.add(each) for each in requests] == [[]] * limit + [[requests[0]]]


@pytest.mark.parametrize("limit", [1, 2])
def test_beyond_the_limit_conversations_without_twin_are_examined_again(
    monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    monkeypatch.setattr(joiner_module, "MAX_CONVERSATIONS", limit)
    script = Script()
    first, second = script.client(50001), script.client(50002)
    joiner = Joiner()
    for number, client in enumerate((first, second)):
        request = client.ask(10_000 * number, 1, 0, MOVE)
        assert joiner.add(request) == []
        assert joiner.expire(request.time + HELD_UNANSWERED_NS) == [request]
    again = first.ask(20_000, 2, 0, MOVE)
    assert joiner.add(again) == ([again] if limit == 2 else [])


@pytest.mark.parametrize(("limit", "returned_at_once"), [(1, 0), (2, 2)])
def test_beyond_the_limit_the_conversation_that_was_joined_first_is_joined_no_longer(
    monkeypatch: pytest.MonkeyPatch, limit: int, returned_at_once: int
) -> None:
    monkeypatch.setattr(joiner_module, "MAX_JOINED", limit)
    script = ProxiedScript()
    first, second = script.proxied_client(), script.proxied_client(50002)
    first.calls(0, 10, MOVE)
    second.calls(1000, 10, MOVE)
    first.call(2000, 11, OTHER)
    joiner = Joiner()
    returned = [each for seen in script.in_order() for each in joiner.add(seen)]
    assert len([each for each in returned if each.time >= START + 2000 * MS]) == returned_at_once


def test_a_frame_whose_twin_is_missing_does_not_hold_back_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joiner_module, "MAX_WAITING", 100)
    script = ProxiedScript()
    client, direct = script.proxied_client(), script.client(50002)
    client.calls(0, 10, MOVE)
    direct.ask(0.5, 1, 0, OTHER)
    direct.reply(1, 1)
    direct.ask(2, 2, 0, OTHER)
    direct.reply(3, 2)
    client.ask(1000, 11, 0, OTHER, lost=True)
    for serial in range(3, 500):
        direct.ask(1000 + serial / 10, serial, 0, OTHER)
    joiner = Joiner()
    waiting = largest = 0
    for seen in script.in_order():
        due = joiner.add(seen)
        returned = sum(len(sighting_numbers(each)) for each in due)
        waiting += 1 - returned
        largest = max(largest, waiting)
    assert 90 <= largest <= 103
    assert waiting == 0


def test_frames_of_one_time_keep_their_order() -> None:
    script = Script()
    alone, new = script.client(), script.client(50002)
    alone.ask(0, 1, 0, MOVE)
    alone.reply(1, 1)
    alone.ask(2, 2, 0, MOVE)
    alone.reply(3, 2)
    new.ask(4, 1, 0, OTHER)
    alone.ask(4, 3, 0, MOVE)
    joiner = Joiner()
    assert [each.number for seen in script.seen for each in joiner.add(seen)] == [1, 2, 3, 4]
    assert [each.number for each in joiner.close()] == [5, 6]
