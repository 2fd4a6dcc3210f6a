"""Curves drawn with braille characters."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.render.color_palette import Palette
from bcapscope.render.text_charts import braille_chart


def test_a_rising_line_goes_from_corner_to_corner() -> None:
    lines = braille_chart([([(0, 0), (3, 7)], "")], 12, 3, unit="°")
    assert [line[10:].rstrip() for line in lines[:2]] == [" ⡜", "⡜"]
    assert lines[0].startswith("       7°│")
    assert lines[1].startswith("       0°│")


def test_each_curve_has_its_style() -> None:
    palette = Palette(good="<g>", bad="<b>", reset="</>")
    lines = braille_chart([([(0, 0), (1, 0)], "<g>"), ([(0, 9), (1, 9)], "<b>")], 20, 4, palette)
    assert "<b>⠉" in lines[0]
    assert "<g>⣀" in lines[2]


def test_nothing_is_an_empty_frame() -> None:
    assert len(braille_chart([], 20, 4)) == 4
    assert len(braille_chart([([(0, float("nan"))], "")], 20, 4)) == 4


@given(
    st.lists(st.lists(st.tuples(st.floats(), st.floats()), max_size=8), max_size=3),
    st.integers(0, 40),
    st.integers(0, 12),
)
def test_any_numbers_fit_into_the_frame(
    points: list[list[tuple[float, float]]], width: int, height: int
) -> None:
    lines = braille_chart([(each, "") for each in points], width, height, unit="deg")
    assert len(lines) == max(2, height)
    assert max(map(len, lines)) <= max(11, width)


def test_a_label_of_many_digits_leaves_the_frame_where_it_is() -> None:
    lines = braille_chart([([(0, -123456.0), (1, 123456.0)], "")], 30, 4, unit="mm")
    assert {line.find("│") for line in lines[:-1]} == {9}
    assert lines[0].startswith("1.2e+05mm")
    assert lines[2].startswith(" -1e+05mm")
