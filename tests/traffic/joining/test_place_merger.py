"""One conversation at two places: each frame is delivered once, with what both places show of it."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import Variant
from bcapscope.traffic.joining.joined_observation import CapturePlace, JoinedObservation
from bcapscope.traffic.joining.place_merger import (
    LEGS_OF_PROXY,
    MAX_OVERDUE,
    MAX_PENDING,
    CapturedTwins,
    Coverage,
    PlaceMerger,
)
from bcapscope.traffic.observation import Observation, Transport
from tests.traffic.joining.two_places import ProxiedScript
from tests.traffic.playbook import MOVE, MS, OTHER, POSE, START, i4

NEAR, FAR = CapturePlace
NS = 1e-6
SECOND = 1_000_000_000
DIRECT = CapturedTwins(is_relayed=False)


class Merging:
    """A merger of both legs, and what it has delivered."""

    def __init__(self, twins: CapturedTwins = LEGS_OF_PROXY, transport: Transport = Transport.UDP) -> None:
        client = ProxiedScript().proxied_client(transport=transport)
        self.sides = client.near, client.far
        self.delivered: list[JoinedObservation] = []
        self.merger = PlaceMerger(client.near.conversation, self.delivered.append, lambda _: (), twins)

    def ask(
        self, place: CapturePlace, ms: float, serial: int, question: tuple[int, tuple[Variant, ...]] = MOVE
    ) -> Observation:
        return self.add(place, self.sides[place].ask(ms, serial, 0, question))

    def reply(self, place: CapturePlace, ms: float, serial: int, *results: Variant) -> Observation:
        return self.add(place, self.sides[place].reply(ms, serial, 0, 0, *results))

    def add(self, place: CapturePlace, observation: Observation) -> Observation:
        self.merger.add(observation, place)
        return observation

    def expire(self, ms: float) -> None:
        self.merger.expire(START + round(ms * MS))

    @property
    def sightings(self) -> list[tuple[Observation | None, Observation | None]]:
        return [(each.at_client, each.at_controller) for each in self.delivered]


def test_a_frame_at_both_places_of_a_proxy_is_one_frame() -> None:
    both = Merging()
    sent, arrived = both.ask(NEAR, 0, 1), both.ask(FAR, 1, 1)
    replied, received = both.reply(FAR, 2, 1, POSE), both.reply(NEAR, 3, 1, POSE)
    assert both.sightings == [(sent, arrived), (received, replied)]
    assert {(each.is_missed, each.is_relayed, each.delay_error) for each in both.delivered} == {
        (False, True, 0)
    }
    assert both.merger.earliest_pending is None


def test_a_frame_waits_a_second_for_its_second_sighting() -> None:
    both = Merging()
    both.ask(NEAR, 0, 1)
    both.expire(1000)
    assert both.merger.earliest_pending == START
    both.expire(1000 + NS)
    (lost,) = both.delivered
    assert lost.was_lost_between


def test_a_request_that_arrives_after_that_was_not_lost() -> None:
    both = Merging()
    sent = both.ask(NEAR, 0, 1)
    both.expire(2000)
    arrived = both.ask(FAR, 3000, 1)
    both.merger.close()
    assert both.sightings == [(sent, arrived)]
    assert not both.delivered[0].is_missed


def test_the_same_bytes_again_from_the_client_are_another_request() -> None:
    both = Merging()
    first = both.ask(NEAR, 0, 1)
    both.expire(2000)
    second = both.ask(NEAR, 3000, 1)
    both.expire(5000)
    assert both.sightings == [(first, None), (second, None)]
    assert all(each.was_lost_between for each in both.delivered)


def test_a_reply_that_arrives_after_that_is_another_frame() -> None:
    both = Merging()
    replied = both.reply(FAR, 0, 1)
    both.expire(2000)
    received = both.reply(NEAR, 3000, 1)
    both.merger.close()
    assert both.sightings == [(None, replied), (received, None)]


def test_a_frame_that_the_proxy_changed_is_one_frame() -> None:
    both = Merging()
    sent, replied = both.ask(NEAR, 0, 1, MOVE), both.reply(FAR, 1, 1, POSE)
    received, arrived = both.reply(NEAR, 2, 1, i4(7)), both.ask(FAR, 3, 1, OTHER)
    both.expire(2000)
    assert both.sightings == [(sent, arrived), (received, replied)]
    again = both.ask(NEAR, 3000, 1, OTHER)
    both.expire(5000)
    assert both.sightings[2:] == [(again, None)]


def test_the_requests_of_the_proxy_are_counted() -> None:
    both = Merging()
    both.ask(NEAR, 0, 1)  # lost
    both.reply(NEAR, 1, 1)  # made by the proxy
    both.reply(FAR, 2, 2)  # lost
    assert both.merger.own_requests == 0
    both.ask(FAR, 3, 3)
    both.ask(FAR, 4, 4)
    both.expire(2000)
    assert [each.was_made_between for each in both.delivered] == [False, True, False, True, True]
    assert both.merger.own_requests == 2


def test_the_reply_to_a_request_of_the_proxy_does_not_reach_the_client() -> None:
    both = Merging()
    both.ask(FAR, 0, 1)
    both.reply(FAR, 1, 1)
    both.reply(FAR, 2, 2)
    both.merger.close()
    assert [each.is_missed for each in both.delivered] == [True, True, False]


@pytest.mark.parametrize("time", [0, START])
def test_the_last_frame_may_have_arrived_after_the_end_of_the_capture(time: int) -> None:
    both = Merging()
    both.add(NEAR, both.sides[NEAR].ask(0, 1, 0, MOVE)._replace(time=time))
    both.merger.close()
    assert [each.is_missed for each in both.delivered] == [False]


@pytest.mark.parametrize(("ms", "is_missed"), [(10 - NS, True), (10, False)])
def test_a_frame_before_one_that_arrived_was_missed(ms: float, is_missed: bool) -> None:
    both = Merging()
    both.ask(NEAR, ms, 1)
    both.ask(NEAR, 10, 2)
    both.ask(FAR, 11, 2)
    both.merger.close()
    (last,) = (each for each in both.delivered if each.at_controller is None)
    assert last.is_missed is is_missed


@pytest.mark.parametrize(("ms", "is_missed"), [(5 - NS, False), (5, True)])
def test_a_frame_before_the_other_capture_began_was_not_missed(ms: float, is_missed: bool) -> None:
    both = Merging(CapturedTwins((Coverage(begins=START + 5 * MS), Coverage()), is_relayed=False))
    both.reply(FAR, ms, 1)
    both.expire(2000)
    assert [each.is_missed for each in both.delivered] == [is_missed]


@pytest.mark.parametrize(("ms", "is_missed"), [(0, True), (NS, False)])
def test_a_frame_in_the_last_second_of_the_other_capture_was_not_missed(ms: float, is_missed: bool) -> None:
    both = Merging(CapturedTwins((Coverage(), Coverage(ends=START + SECOND)), is_relayed=False))
    both.ask(NEAR, ms, 1)
    both.expire(2000)
    assert [each.is_missed for each in both.delivered] == [is_missed]


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_tcp_loses_no_frame_without_a_proxy(transport: Transport) -> None:
    both = Merging(DIRECT, transport)
    both.ask(NEAR, 0, 1)
    both.expire(2000)
    assert [each.was_lost_between for each in both.delivered] == [transport is Transport.UDP]


def test_only_so_many_frames_wait_for_their_second_sighting() -> None:
    both = Merging()
    oldest = both.ask(NEAR, 0, 1)
    for number in range(1, MAX_PENDING):
        both.add(NEAR, both.sides[NEAR].ask(0, number & 0xFFFF, number >> 16, OTHER))
    assert both.delivered == []
    both.reply(NEAR, 1, 2)
    assert both.sightings == [(oldest, None)]
    assert not both.delivered[0].is_missed


@pytest.mark.parametrize(("lost", "is_remembered"), [(MAX_OVERDUE, True), (MAX_OVERDUE + 1, False)])
def test_only_so_many_lost_requests_are_remembered(lost: int, is_remembered: bool) -> None:
    both = Merging()
    sent = [both.ask(NEAR, 0, serial) for serial in range(lost)]
    both.expire(2000)
    arrived = both.ask(FAR, 3000, 0)
    assert both.sightings[0] == (sent[0], arrived if is_remembered else None)
    assert len(both.delivered) == lost
