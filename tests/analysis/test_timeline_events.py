"""Marks: as many as a picture can show, and none that is not counted."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.timeline_events import TimelineEvent, TimelineEventList


def mark(time: int, lasting: int = 0) -> TimelineEvent:
    return TimelineEvent(time, time + lasting, 1, time + 1)


def test_all_are_kept_as_long_as_there_is_room() -> None:
    marks = TimelineEventList(3)
    for time in (5, 5, 9):
        marks.add(mark(time))
    assert marks.all == (mark(5), mark(5), mark(9))


def test_what_is_closer_than_a_pause_is_one() -> None:
    marks = TimelineEventList(10, pause=100)
    for time in (0, 99, 250, 340):
        marks.add(mark(time, 10))
    assert marks.all == (TimelineEvent(0, 109, 2, 1), TimelineEvent(250, 350, 2, 251))


def test_neighbours_become_one_when_there_are_too_many() -> None:
    marks = TimelineEventList(4)
    for time in (0, 1, 2, 1000, 2000):
        marks.add(mark(time))
    assert marks.all == (TimelineEvent(0, 2, 3, 1), mark(1000), mark(2000))


@given(
    st.lists(st.tuples(st.integers(-100, 10_000), st.integers(0, 300)), max_size=300),
    st.integers(1, 20),
    st.integers(0, 50),
)
def test_none_is_lost_and_there_are_never_too_many(
    happened: list[tuple[int, int]], most: int, pause: int
) -> None:
    marks = TimelineEventList(most, pause)
    for time, lasting in happened:
        marks.add(mark(time, lasting))
        assert len(marks.all) <= most
    assert sum(each.occurrences for each in marks.all) == len(happened)
    if happened:
        assert marks.all[0].begin == happened[0][0]
        assert max(each.end for each in marks.all) == max(time + lasting for time, lasting in happened)
