"""Who waits, who gets in and who is dropped."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.transport.first_frame_queue import FIRST_FRAME_TIMEOUT, FirstFrameQueue, source_network

FRAME = encode_frame(1, 0, 1)
ONE, OTHER = "10.0.0.1", "10.0.0.2"


def test_a_complete_frame_gets_in_however_it_is_cut() -> None:
    for cut in range(1, len(FRAME)):
        lobby: FirstFrameQueue[int] = FirstFrameQueue()
        assert lobby.add(1, ONE) is None
        assert lobby.feed_bytes(1, FRAME[:cut], 1) is None
        assert lobby.feed_bytes(1, FRAME[cut:] + b"more", 2) == FRAME + b"more"
        assert 1 not in lobby


@given(st.binary(min_size=1).filter(lambda data: data[0] != 1))
def test_what_is_no_frame_gets_in_at_once(data: bytes) -> None:
    lobby: FirstFrameQueue[int] = FirstFrameQueue()
    lobby.add(1, ONE)
    assert lobby.feed_bytes(1, data, 1) == data


@given(
    st.lists(st.tuples(st.integers(0, 9), st.sampled_from((ONE, OTHER, "::1")), st.booleans()), max_size=60)
)
def test_there_is_never_more_than_the_limit(steps: list[tuple[int, str, bool]]) -> None:
    lobby: FirstFrameQueue[int] = FirstFrameQueue(3)
    present: set[int] = set()
    for number, (chance, host, speaks) in enumerate(steps):
        dropped = lobby.add(number, host)
        present.add(number)
        if dropped is not None:
            present.remove(dropped)
        if speaks:
            lobby.feed_bytes(number, FRAME[:5], chance + 1)
        assert len(lobby) == len(present) <= 3
        assert all(each in lobby for each in present)
        assert number in lobby


def test_the_oldest_of_the_greediest_source_is_dropped_first() -> None:
    lobby: FirstFrameQueue[str] = FirstFrameQueue(4)
    lobby.add("alone", OTHER)
    for name in ("first", "second", "third"):
        lobby.add(name, ONE)
    lobby.feed_bytes("first", b"\x01", 1)
    assert lobby.add("a", ONE) == "first"
    assert lobby.add("b", OTHER) == "second"
    assert lobby.drop_one() in {"third", "alone"}  # two of each source are left


def test_who_has_just_come_is_not_dropped_for_those_that_have_sent_a_few_bytes() -> None:
    lobby: FirstFrameQueue[int] = FirstFrameQueue(8)
    for number in range(8):
        lobby.add(number, ONE)
        lobby.feed_bytes(number, b"\x01", 1)
    lobby.add(100, ONE)
    for number in range(8, 15):
        assert lobby.add(number, ONE) != 100
        lobby.feed_bytes(number, b"\x01", 1)


def test_a_first_frame_must_be_complete_in_time_and_silence_is_not_limited() -> None:
    lobby: FirstFrameQueue[int] = FirstFrameQueue()
    lobby.add(1, ONE)
    lobby.add(2, ONE)
    lobby.feed_bytes(2, b"\x01", 5)
    assert lobby.drop_overdue(5 + FIRST_FRAME_TIMEOUT) == []
    assert lobby.drop_overdue(6 + FIRST_FRAME_TIMEOUT) == [2]
    assert lobby.drop_overdue(10**15) == []
    assert 1 in lobby


def test_an_empty_lobby_drops_nobody() -> None:
    lobby: FirstFrameQueue[int] = FirstFrameQueue()
    lobby.add(1, ONE)
    lobby.remove(1)
    lobby.remove(1)
    assert lobby.drop_one() is None


def test_addresses_of_one_ipv6_network_are_one_source() -> None:
    assert source_network("2001:db8:1:2::3") == source_network("2001:db8:1:2:ffff::4")
    assert source_network("2001:db8:1:2::3") != source_network("2001:db8:1:3::3")
    assert source_network("fe80::1%eth0") == source_network("fe80::2%eth0")
    assert source_network("10.0.0.1") != source_network("10.0.0.2")
