"""The two legs of a proxied conversation come out as one, in order of time, and nothing is kept back."""

from __future__ import annotations

import pytest

from bcapscope.messages import Message
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.joining.leg_joiner import DeliveryQueue, LegJoiner, RelayedObservation
from bcapscope.traffic.joining.place_merger import JOIN_WITHIN_NS
from bcapscope.traffic.observation import Observation
from tests.traffic.joining.two_places import START_SERVICE, ProxiedScript
from tests.traffic.playbook import START

MS = 1_000_000
LIMIT_MS = JOIN_WITHIN_NS / MS


def near_numbers(observations: list[Observation]) -> list[int]:
    return [each.number for each in observations]


class Legs:
    """A joiner of the two legs of one client, and a second client that goes direct."""

    def __init__(self) -> None:
        script = ProxiedScript()
        self.client = script.proxied_client()
        self.direct = script.proxied_client(port=50002).near
        self.joiner = LegJoiner()
        self.joiner.join(self.client.near.conversation, self.client.far.conversation)


def test_both_legs_give_one_observation() -> None:
    legs = Legs()
    near = legs.client.near.ask(0, 1, 0, START_SERVICE)
    far = legs.client.far.ask(1, 1, 0, START_SERVICE)
    assert legs.joiner.add(near) == []
    (joined,) = legs.joiner.add(far)
    assert isinstance(joined, JoinedObservation)
    assert (joined.at_client, joined.at_controller) == (near, far)
    assert legs.joiner.delivered_until >= near.time


@pytest.mark.parametrize(
    ("note", "shown"), [(None, ""), (Message("session.closing"), "the proxy ends the session")]
)
def test_the_note_of_the_proxy_stays(note: Message | None, shown: str) -> None:
    legs = Legs()
    near = RelayedObservation(*legs.client.near.ask(0, 1, 0, START_SERVICE))
    near.note = note
    legs.joiner.add(near)
    (joined,) = legs.joiner.add(legs.client.far.ask(1, 1, 0, START_SERVICE))
    assert isinstance(joined, JoinedObservation)
    assert joined.note == shown


def test_a_frame_waits_for_its_twin_and_later_frames_wait_too() -> None:
    legs = Legs()
    waiting = legs.client.near.ask(0, 1, 0, START_SERVICE)
    later = legs.direct.ask(1, 1, 0, START_SERVICE)
    assert legs.joiner.add(waiting) == legs.joiner.add(later) == []
    assert legs.joiner.delivered_until == waiting.time - 1
    assert legs.joiner.expire(waiting.time + JOIN_WITHIN_NS) == []
    due = legs.joiner.expire(waiting.time + JOIN_WITHIN_NS + 1)
    assert near_numbers(due) == [waiting.number, later.number]


def test_frames_of_an_earlier_time_do_not_wait() -> None:
    legs = Legs()
    earlier = legs.direct.ask(0, 1, 0, START_SERVICE)
    waiting = legs.client.near.ask(1, 1, 0, START_SERVICE)
    assert legs.joiner.add(earlier) == [earlier]
    assert legs.joiner.add(waiting) == []


def test_a_client_that_disconnects_gets_its_waiting_frames() -> None:
    legs = Legs()
    waiting = legs.client.near.ask(0, 1, 0, START_SERVICE)
    other = legs.direct.ask(1, 1, 0, START_SERVICE)
    assert legs.joiner.add(waiting) == legs.joiner.add(other) == []
    assert near_numbers(legs.joiner.close_conversation(legs.client.near.conversation)) == [waiting.number]
    assert legs.joiner.expire(other.time) == [other]
    assert legs.joiner.is_idle
    after = legs.client.near.ask(2, 2, 0, START_SERVICE)
    assert legs.joiner.add(after) == [after]  # the legs are joined no longer


def test_an_unknown_client_has_no_waiting_frames() -> None:
    legs = Legs()
    waiting = legs.client.near.ask(0, 1, 0, START_SERVICE)
    legs.joiner.add(waiting)
    assert legs.joiner.close_conversation(legs.direct.conversation) == []
    assert near_numbers(legs.joiner.close()) == [waiting.number]


def test_a_joiner_with_legs_is_not_idle() -> None:
    assert not Legs().joiner.is_idle
    assert LegJoiner().is_idle


def test_a_frame_later_than_the_clock_waits_for_the_clock() -> None:
    legs = Legs()
    first = legs.direct.ask(5, 1, 0, START_SERVICE)
    assert legs.joiner.add(first) == [first]
    late = legs.direct.ask(3, 2, 0, START_SERVICE)
    assert legs.joiner.add(late) == [late]
    assert legs.joiner.delivered_until == first.time


def test_a_clock_set_back_delivers_what_waits() -> None:
    legs = Legs()
    waiting = legs.client.near.ask(LIMIT_MS + 10, 1, 0, START_SERVICE)
    assert legs.joiner.add(waiting) == []
    assert legs.joiner.expire(waiting.time - JOIN_WITHIN_NS) == []
    due = legs.joiner.expire(waiting.time - JOIN_WITHIN_NS - 1)
    assert near_numbers(due) == [waiting.number]
    again = legs.client.near.ask(0, 2, 0, START_SERVICE)
    assert legs.joiner.add(again) == []
    assert legs.joiner.delivered_until == START - 1


def test_the_queue_orders_by_time_then_number() -> None:
    client = ProxiedScript().proxied_client().near
    frames = [client.ask(ms, serial, 0, START_SERVICE) for serial, ms in enumerate((2, 1, 1, 3), 1)]
    queue = DeliveryQueue()
    for each in reversed(frames):
        queue.add(each)
    assert len(queue) == len(frames)
    assert queue.find({client.conversation}) == {
        client.conversation: [frames[1], frames[2], frames[0], frames[3]]
    }
    assert queue.pop_until(frames[0].time) == [frames[1], frames[2], frames[0]]
    assert queue.pop_all() == [frames[3]]
    assert len(queue) == 0


def test_the_queue_removes_one_conversation() -> None:
    client = ProxiedScript().proxied_client()
    queue = DeliveryQueue()
    near, far = client.near.ask(0, 1, 0, START_SERVICE), client.far.ask(1, 1, 0, START_SERVICE)
    last = client.far.ask(2, 2, 0, START_SERVICE)
    for each in (last, near, far):
        queue.add(each)
    assert queue.find({far.flow.conversation}) == {far.flow.conversation: [far, last]}
    assert queue.remove(near.flow.conversation) == [near]
    assert queue.remove(near.flow.conversation) == []
    assert queue.pop_until(far.time) == [far]
    assert queue.pop_all() == [last]
