"""Watched variables."""

from __future__ import annotations

from bcapscope.protocol.variant import VT, Variant
from bcapscope.tui.desk.watch import REMEMBERED, Watched

SECOND = 1_000_000_000


def test_each_element_has_extremes_rate_and_course() -> None:
    watched = Watched("Arm.@CURRENT_ANGLE", 3)
    watched.take(Variant.array(VT.R4, (1.0, 10.0)), 0)
    watched.take(Variant.array(VT.R4, (3.0, 5.0)), SECOND // 2)
    first, second = watched.series
    assert watched.decimals == 5
    assert (first.last, first.least, first.most, first.rate) == (3.0, 1.0, 3.0, 4.0)
    assert second.rate == -10.0
    assert second.course(10) == "█▁"


def test_text_has_no_course() -> None:
    watched = Watched("@VERSION", 3)
    watched.take(Variant(VT.BSTR, "3.0"), 0)
    assert watched.series == []
    assert watched.value == Variant(VT.BSTR, "3.0")


def test_what_cannot_be_read_says_why_until_it_can() -> None:
    watched = Watched("I1", 3)
    watched.fail("E_HANDLE")
    assert watched.trouble == "E_HANDLE"
    watched.take(Variant(VT.I4, 1), 0)
    assert watched.trouble == ""


def test_the_course_is_bounded_the_extremes_are_not() -> None:
    watched = Watched("I1", 3)
    for number in range(1000):
        watched.take(Variant(VT.I4, number), number * SECOND)
    (series,) = watched.series
    assert watched.decimals == 0
    assert len(series.points) == REMEMBERED
    assert (series.least, series.most) == (0.0, 999.0)
    watched.reset()
    assert watched.series[0].least is None
