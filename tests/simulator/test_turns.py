"""Whose turn it is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.simulator.turns import MOST_BYTES, MOST_OF_ONE, Turns


def test_the_oldest_of_each_sender_comes_first() -> None:
    turns: Turns[str] = Turns()
    for sender, data in (("a", b"1"), ("a", b"2"), ("b", b"3"), ("a", b"4"), ("b", b"5")):
        turns.add(sender, data)
    assert [list(turns.take()) for _ in range(3)] == [
        [("a", b"1"), ("b", b"3")],
        [("a", b"2"), ("b", b"5")],
        [("a", b"4")],
    ]
    assert not turns


@given(st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=3)), max_size=200))
def test_what_one_sends_stays_in_order_and_nothing_is_lost_silently(sent: list[tuple[int, bytes]]) -> None:
    turns: Turns[int] = Turns()
    for sender, data in sent:
        turns.add(sender, data)
    heard: list[tuple[int, bytes]] = []
    while turns:
        heard += turns.take()
    for sender in range(4):
        of_sender = [data for each, data in sent if each == sender]
        assert [data for each, data in heard if each == sender] == of_sender[:MOST_OF_ONE]
    assert turns.unheard == len(sent) - len(heard)


def test_many_senders_fill_no_more_memory_than_few() -> None:
    turns: Turns[int] = Turns()
    for sender in range(100_000):
        turns.add(sender, b"")
    assert len(list(turns.take())) < MOST_BYTES / 500
    assert turns.unheard > 90_000
    turns.add(1, b"x")
    assert list(turns.take()) == [(1, b"x")]
