"""Whose turn it is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.simulator.listening_sockets import MAX_BYTES, MAX_PER_SENDER, DatagramQueue


def test_the_oldest_of_each_sender_comes_first() -> None:
    turns = DatagramQueue()
    for came, (sender, data) in enumerate((("a", b"1"), ("a", b"2"), ("b", b"3"), ("a", b"4"), ("b", b"5"))):
        turns.add(sender, came, data)
    rounds = []
    while turns.waiting:
        rounds.append((turns.oldest_arrival, list(turns.pop_one_per_sender())))
    assert rounds == [
        (0, [("a", 0, b"1"), ("b", 2, b"3")]),
        (1, [("a", 1, b"2"), ("b", 4, b"5")]),
        (3, [("a", 3, b"4")]),
    ]


@given(st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=3)), max_size=200))
def test_what_one_sends_stays_in_order_and_nothing_is_lost_silently(sent: list[tuple[int, bytes]]) -> None:
    turns = DatagramQueue()
    for sender, data in sent:
        turns.add(sender, 0, data)
    heard: list[tuple[object, bytes]] = []
    while turns.waiting:
        heard += [(sender, data) for sender, _, data in turns.pop_one_per_sender()]
    for sender in range(4):
        of_sender = [data for each, data in sent if each == sender]
        assert [data for each, data in heard if each == sender] == of_sender[:MAX_PER_SENDER]
    assert turns.dropped == len(sent) - len(heard)


def test_many_senders_fill_no_more_memory_than_few() -> None:
    turns = DatagramQueue()
    for sender in range(100_000):
        turns.add(sender, 0, b"")
    assert len(list(turns.pop_one_per_sender())) < MAX_BYTES / 500
    assert turns.dropped > 90_000
    turns.add(1, 0, b"x")
    assert list(turns.pop_one_per_sender()) == [(1, 0, b"x")]
