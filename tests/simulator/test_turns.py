"""Whose turn it is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.simulator.turns import MOST_BYTES, MOST_OF_ONE, Turns


def test_the_oldest_of_each_sender_comes_first() -> None:
    turns: Turns[str] = Turns()
    for came, (sender, data) in enumerate((("a", b"1"), ("a", b"2"), ("b", b"3"), ("a", b"4"), ("b", b"5"))):
        turns.add(sender, came, data)
    rounds = []
    while turns.waiting:
        rounds.append((turns.since, list(turns.take())))
    assert rounds == [
        (0, [("a", 0, b"1"), ("b", 2, b"3")]),
        (1, [("a", 1, b"2"), ("b", 4, b"5")]),
        (3, [("a", 3, b"4")]),
    ]


@given(st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=3)), max_size=200))
def test_what_one_sends_stays_in_order_and_nothing_is_lost_silently(sent: list[tuple[int, bytes]]) -> None:
    turns: Turns[int] = Turns()
    for sender, data in sent:
        turns.add(sender, 0, data)
    heard: list[tuple[int, bytes]] = []
    while turns.waiting:
        heard += [(sender, data) for sender, _, data in turns.take()]
    for sender in range(4):
        of_sender = [data for each, data in sent if each == sender]
        assert [data for each, data in heard if each == sender] == of_sender[:MOST_OF_ONE]
    assert turns.unheard == len(sent) - len(heard)


def test_many_senders_fill_no_more_memory_than_few() -> None:
    turns: Turns[int] = Turns()
    for sender in range(100_000):
        turns.add(sender, 0, b"")
    assert len(list(turns.take())) < MOST_BYTES / 500
    assert turns.unheard > 90_000
    turns.add(1, 0, b"x")
    assert list(turns.take()) == [(1, 0, b"x")]
