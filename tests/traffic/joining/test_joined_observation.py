"""What a joined observation says about a frame that was captured at one place or at both."""

from __future__ import annotations

import pytest

from bcapscope.traffic.joining.joined_observation import (
    CapturePlace,
    JoinedObservation,
    join_sightings,
    numbered,
    sighting_numbers,
)
from bcapscope.traffic.observation import Observation
from tests.traffic.joining.two_places import START_SERVICE, ProxiedScript


def sightings() -> tuple[Observation, Observation]:
    """The same request at the client's and at the controller's side, 2 ms later."""
    client = ProxiedScript().proxied_client()
    return client.near.ask(0, 1, 0, START_SERVICE), client.far.ask(2, 1, 0, START_SERVICE)


def test_two_sightings_keep_the_time_and_number_of_the_client() -> None:
    near, far = sightings()
    joined = join_sightings(near, far, near.flow)
    assert (joined.number, joined.time, joined.packet) == (near.number, near.time, near.packet)
    assert (joined.delay, joined.held_by_proxy) == (2_000_000, 2_000_000)
    assert sighting_numbers(joined) == (near.number, far.number)
    assert not joined.is_missed


def test_one_sighting_has_no_delay() -> None:
    near, _ = sightings()
    joined = join_sightings(near, None, near.flow)
    assert (joined.delay, joined.held_by_proxy) == (None, 0)
    assert sighting_numbers(joined) == (near.number,)


def test_without_a_proxy_nothing_held_the_frame() -> None:
    near, far = sightings()
    assert join_sightings(near, far, near.flow, is_relayed=False).held_by_proxy == 0


def test_a_new_number_changes_nothing_else() -> None:
    near, far = sightings()
    joined = join_sightings(None, far, near.flow, is_missed=True, is_relayed=False, note="n", delay_error=7)
    copy = numbered(joined, 12)
    assert isinstance(copy, JoinedObservation)
    assert (copy.number, sighting_numbers(copy), copy.at_client) == (12, (12,), None)
    assert (copy.is_missed, copy.is_relayed, copy.note, copy.delay_error) == (True, False, "n", 7)
    assert (copy.time, copy.flow, copy.item) == (far.time, near.flow, far.item)
    assert sighting_numbers(joined) == (far.number,)


def test_a_frame_of_one_place_has_one_number() -> None:
    near, _ = sightings()
    assert sighting_numbers(near) == (near.number,)
    assert sighting_numbers("a gap") == ()


@pytest.mark.parametrize("place", list(CapturePlace))
def test_each_place_has_its_own_sighting(place: CapturePlace) -> None:
    ends = sightings()
    joined = join_sightings(*ends, ends[0].flow)
    assert [*joined.sightings()][place] is ends[place]
