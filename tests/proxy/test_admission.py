"""Who gets a place among the clients, and who gives one up."""

from __future__ import annotations

from typing import cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.messages import Message
from bcapscope.proxy.admission import (
    MAX_CLIENTS,
    MAX_PER_SOURCE,
    REPLACE_BURST,
    REPLACE_INTERVAL_NS,
    RESERVED_SLOTS,
    TOO_MANY_CLIENTS,
    ClientSlot,
    ClientSlots,
)
from bcapscope.proxy.relay_session import RelaySession

ONE, OTHER, THIRD = "10.0.0.1", "10.0.0.2", "10.0.0.3"


class Client:
    """A client that says itself how long it was quiet."""

    def __init__(self, world: World, number: int, source: str) -> None:
        self.number = number
        self.source = source
        self.silence: int | None = None
        self.asked: list[int] = []
        self._world = world

    def evictable_idle_ns(self, now: int) -> int | None:
        self.asked.append(now)
        return self.silence

    def close(self, reset: bool, why: Message) -> None:
        assert not reset
        assert why == TOO_MANY_CLIENTS
        self._world.ended.append(self.number)
        self._world.places.release(self.number)


class World:
    """Places, and all who came.

    Attributes:
        clients: by number, those that got a place.
        ended: numbers of those that gave theirs up.
    """

    def __init__(self) -> None:
        self.places = ClientSlots()
        self.clients: dict[int, Client] = {}
        self.ended: list[int] = []
        self.now = 10**12
        self._number = 0

    def come(self, host: str, *, stop: bool = False, fresh: bool = False) -> ClientSlot:
        """Let a client come; it gets what it gets."""
        place = self.places.find_slot(host, self.now, stop)
        if place is not ClientSlot.NONE:
            self._number += 1
            client = self.clients[self._number] = Client(self, self._number, host)
            self.places.occupy(cast(RelaySession, client), place, is_fresh=fresh)
        return place

    def fill(self, *, fresh: bool = False) -> None:
        """Take all usual places."""
        for host, count in ((ONE, MAX_PER_SOURCE), (OTHER, MAX_CLIENTS - MAX_PER_SOURCE)):
            for _ in range(count):
                assert self.come(host, fresh=fresh) is ClientSlot.REGULAR


def test_one_address_leaves_places_for_others() -> None:
    world = World()
    for _ in range(MAX_PER_SOURCE):
        assert world.come(ONE) is ClientSlot.REGULAR
    assert world.come(ONE) is ClientSlot.NONE
    assert world.come(OTHER) is ClientSlot.REGULAR
    world.places.release(1)
    assert world.come(ONE) is ClientSlot.REGULAR
    assert not world.ended


def test_a_client_that_stays_is_never_ended_for_another() -> None:
    world = World()
    world.fill()
    for host in (ONE, OTHER, THIRD):
        assert world.come(host) is ClientSlot.NONE
    assert not world.ended


def test_who_was_quiet_for_longest_gives_its_place_up() -> None:
    world = World()
    world.fill()
    world.clients[5].silence, world.clients[9].silence = 20, 30
    assert world.come(THIRD) is ClientSlot.REGULAR
    assert world.come(THIRD) is ClientSlot.REGULAR
    assert world.come(THIRD) is ClientSlot.NONE
    assert world.ended == [9, 5]


def test_an_address_with_too_many_gives_up_its_own() -> None:
    world = World()
    assert world.come(OTHER) is ClientSlot.REGULAR
    for _ in range(MAX_PER_SOURCE):
        world.come(ONE)
    world.clients[1].silence, world.clients[2].silence = 50, 20
    assert world.come(ONE) is ClientSlot.REGULAR
    assert world.ended == [2]


def test_what_was_in_vain_is_tried_again_later() -> None:
    world = World()
    world.fill()
    assert world.come(THIRD) is ClientSlot.NONE
    world.clients[7].silence = 10**10
    world.now += 1
    assert world.come(THIRD) is ClientSlot.REGULAR


def test_a_search_in_vain_is_not_repeated_at_the_same_time() -> None:
    world = World()
    world.fill()
    asked: list[int] = []
    world.clients[7].asked = asked
    for _ in range(5):
        assert world.come(THIRD) is ClientSlot.NONE
    assert asked == [world.now]
    world.now += 1
    assert world.come(THIRD) is ClientSlot.NONE
    assert asked == [world.now - 1, world.now]


def test_stops_always_get_in_and_the_newest_of_them_stay() -> None:
    world = World()
    world.fill()
    for _ in range(RESERVED_SLOTS):
        assert world.come(ONE, stop=True) is ClientSlot.RESERVED
    assert not world.ended
    assert world.come(THIRD, stop=True) is ClientSlot.RESERVED
    assert world.ended == [MAX_CLIENTS + 1]
    assert len(world.places) == MAX_CLIENTS + RESERVED_SLOTS
    assert world.come(THIRD) is ClientSlot.NONE


def test_a_stop_takes_a_usual_place_while_there_is_one() -> None:
    assert World().come(ONE, stop=True) is ClientSlot.REGULAR


def test_who_spoke_only_once_makes_room_the_oldest_first() -> None:
    world = World()
    world.fill(fresh=True)
    world.places.mark_established(1)
    assert world.come(THIRD, fresh=True) is ClientSlot.REGULAR
    assert world.come(ONE, fresh=True) is ClientSlot.REGULAR
    assert world.ended == [2, 3]


def test_a_flood_changes_places_only_so_often() -> None:
    world = World()
    world.fill(fresh=True)
    places = [world.come(THIRD, fresh=True) for _ in range(REPLACE_BURST + 10)]
    assert places.count(ClientSlot.NONE) == 10
    world.now += 3 * REPLACE_INTERVAL_NS
    assert [world.come(THIRD, fresh=True) for _ in range(4)] == [ClientSlot.REGULAR] * 3 + [ClientSlot.NONE]
    assert world.come(THIRD, stop=True, fresh=True) is ClientSlot.RESERVED


def test_the_oldest_stop_can_be_ended_for_its_file_descriptors() -> None:
    world = World()
    assert not world.places.end_oldest_stop()
    world.fill()
    world.come(ONE, stop=True)
    assert world.places.end_oldest_stop()
    assert world.ended == [MAX_CLIENTS + 1]
    assert not world.places.end_oldest_stop()


@settings(max_examples=30)
@given(st.data())
def test_limits_hold_whatever_comes(data: st.DataObject) -> None:
    world = World()
    world.fill(fresh=data.draw(st.booleans()))
    for _ in range(data.draw(st.integers(0, 80))):
        world.now += data.draw(st.sampled_from((0, 1, REPLACE_INTERVAL_NS)))
        match data.draw(st.sampled_from(("come", "leave", "settle", "quiet"))):
            case "come":
                stop = data.draw(st.booleans())
                host = data.draw(st.sampled_from((ONE, OTHER, THIRD)))
                place = world.come(host, stop=stop, fresh=data.draw(st.booleans()))
                assert not (stop and place is ClientSlot.NONE)
            case "leave":
                world.places.release(data.draw(st.integers(1, MAX_CLIENTS + 20)))
            case "settle":
                world.places.mark_established(data.draw(st.integers(1, MAX_CLIENTS + 20)))
            case _:
                number = data.draw(st.sampled_from(sorted(world.clients)))
                world.clients[number].silence = data.draw(st.integers(10**10, 10**11))
        assert len(world.places) <= MAX_CLIENTS + RESERVED_SLOTS
        assert len(world.ended) == len(set(world.ended))


@pytest.mark.parametrize("hosts", [("2001:db8::1", "2001:db8::2")])
def test_a_network_of_ipv6_counts_as_one_address(hosts: tuple[str, str]) -> None:
    world = World()
    for _ in range(MAX_PER_SOURCE):
        assert world.places.find_slot(hosts[0], world.now, False) is ClientSlot.REGULAR
        number = len(world.clients) + 1
        client = world.clients[number] = Client(world, number, "2001:db8::/64")
        world.places.occupy(cast(RelaySession, client), ClientSlot.REGULAR, is_fresh=False)
    assert world.places.find_slot(hosts[1], world.now, False) is ClientSlot.NONE
