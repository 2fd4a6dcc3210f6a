"""Who waits, who gets in and who is dropped."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.frame import encode
from bcapscope.transport.lobby import FIRST_FRAME_WITHIN, Lobby, source_of

FRAME = encode(1, 0, 1)
ONE, OTHER = "10.0.0.1", "10.0.0.2"


def test_a_complete_frame_gets_in_however_it_is_cut() -> None:
    for cut in range(1, len(FRAME)):
        lobby: Lobby[int] = Lobby()
        assert lobby.enter(1, ONE) is None
        assert lobby.feed(1, FRAME[:cut], 1) is None
        assert lobby.feed(1, FRAME[cut:] + b"more", 2) == FRAME + b"more"
        assert 1 not in lobby


@given(st.binary(min_size=1).filter(lambda data: data[0] != 1))
def test_what_is_no_frame_gets_in_at_once(data: bytes) -> None:
    lobby: Lobby[int] = Lobby()
    lobby.enter(1, ONE)
    assert lobby.feed(1, data, 1) == data


@given(
    st.lists(st.tuples(st.integers(0, 9), st.sampled_from((ONE, OTHER, "::1")), st.booleans()), max_size=60)
)
def test_there_is_never_more_than_the_limit(steps: list[tuple[int, str, bool]]) -> None:
    lobby: Lobby[int] = Lobby(3)
    present: set[int] = set()
    for number, (chance, host, speaks) in enumerate(steps):
        dropped = lobby.enter(number, host)
        present.add(number)
        if dropped is not None:
            present.remove(dropped)
        if speaks:
            lobby.feed(number, FRAME[:5], chance + 1)
        assert len(lobby) == len(present) <= 3
        assert all(each in lobby for each in present)
        assert number in lobby


def test_the_oldest_of_the_greediest_source_is_dropped_first() -> None:
    lobby: Lobby[str] = Lobby(4)
    lobby.enter("alone", OTHER)
    for name in ("first", "second", "third"):
        lobby.enter(name, ONE)
    lobby.feed("first", b"\x01", 1)
    assert lobby.enter("a", ONE) == "first"
    assert lobby.enter("b", OTHER) == "second"
    assert lobby.drop() in {"third", "alone"}  # two of each source are left


def test_who_has_just_come_is_not_dropped_for_those_that_have_sent_a_few_bytes() -> None:
    lobby: Lobby[int] = Lobby(8)
    for number in range(8):
        lobby.enter(number, ONE)
        lobby.feed(number, b"\x01", 1)
    lobby.enter(100, ONE)
    for number in range(8, 15):
        assert lobby.enter(number, ONE) != 100
        lobby.feed(number, b"\x01", 1)


def test_a_first_frame_must_be_complete_in_time_and_silence_is_not_limited() -> None:
    lobby: Lobby[int] = Lobby()
    lobby.enter(1, ONE)
    lobby.enter(2, ONE)
    lobby.feed(2, b"\x01", 5)
    assert lobby.overdue(5 + FIRST_FRAME_WITHIN) == []
    assert lobby.overdue(6 + FIRST_FRAME_WITHIN) == [2]
    assert lobby.overdue(10**15) == []
    assert 1 in lobby


def test_an_empty_lobby_drops_nobody() -> None:
    lobby: Lobby[int] = Lobby()
    lobby.enter(1, ONE)
    lobby.leave(1)
    lobby.leave(1)
    assert lobby.drop() is None


def test_addresses_of_one_ipv6_network_are_one_source() -> None:
    assert source_of("2001:db8:1:2::3") == source_of("2001:db8:1:2:ffff::4")
    assert source_of("2001:db8:1:2::3") != source_of("2001:db8:1:3::3")
    assert source_of("fe80::1%eth0") == source_of("fe80::2%eth0")
    assert source_of("10.0.0.1") != source_of("10.0.0.2")
