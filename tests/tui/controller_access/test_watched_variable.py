"""Watched variables."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.tui.controller_access.watched_variables import MAX_READINGS, WatchedVariable

SECOND = 1_000_000_000


def test_each_element_has_extremes_rate_and_course() -> None:
    watched = WatchedVariable("Arm.@CURRENT_ANGLE", 3)
    watched.add_reading(Variant.array(VT.R4, (1.0, 10.0)), 0)
    watched.add_reading(Variant.array(VT.R4, (3.0, 5.0)), SECOND // 2)
    first, second = watched.series
    assert watched.decimals == 5
    assert (first.last, first.minimum, first.maximum, first.rate) == (3.0, 1.0, 3.0, 4.0)
    assert second.rate == -10.0
    assert [value for _, value in second.readings] == [10.0, 5.0]


def test_text_has_no_course() -> None:
    watched = WatchedVariable("@VERSION", 3)
    watched.add_reading(Variant(VT.BSTR, "3.0"), 0)
    assert watched.series == []
    assert watched.value == Variant(VT.BSTR, "3.0")


def test_what_cannot_be_read_says_why_until_it_can() -> None:
    watched = WatchedVariable("I1", 3)
    watched.problem = "E_HANDLE"
    assert watched.problem == "E_HANDLE"
    watched.add_reading(Variant(VT.I4, 1), 0)
    assert watched.problem == ""


def test_the_course_is_bounded_the_extremes_are_not() -> None:
    watched = WatchedVariable("I1", 3)
    for number in range(1000):
        watched.add_reading(Variant(VT.I4, number), number * SECOND)
    (series,) = watched.series
    assert watched.decimals == 0
    assert len(series.readings) == MAX_READINGS
    assert (series.minimum, series.maximum) == (0.0, 999.0)
    watched.reset_extremes()
    assert watched.series[0].minimum is None
