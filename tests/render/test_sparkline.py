"""Courses of numbers in one line."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.render.text_charts import sparkline


def test_least_and_most_are_the_lowest_and_the_highest() -> None:
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7]) == "▁▂▃▄▅▆▇█"
    assert sparkline([5, -5]) == "█▁"


def test_no_difference_is_level() -> None:
    assert sparkline([3, 3, 3]) == "▁▁▁"


def test_what_is_no_number_is_a_hole() -> None:
    assert sparkline([float("nan"), 1, float("inf"), 2]) == "·▁·█"
    assert sparkline([float("nan")]) == "·"
    assert sparkline([]) == ""


@given(st.lists(st.floats()))
def test_any_numbers_give_one_character_each(values: list[float]) -> None:
    assert len(sparkline(values)) == len(values)
