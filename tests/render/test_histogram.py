"""Histograms as people see them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.statistics.distribution_summary import Bin
from bcapscope.render.color_palette import ANSI
from bcapscope.render.text_charts import BAR_WIDTH, DECADE_EDGES, edges_around, histogram


def test_rows_between_the_first_and_the_last_that_hold_something() -> None:
    bins = [Bin(7.9, 7.95, 1), Bin(7.95, 8.0, 800), Bin(24.0, 24.2, 40)]
    assert list(histogram(bins, edges_around(8.0))) == [
        "     7.9 – 8.1       ████████████████████████████████████████ 801   95.24%",
        "     8.1 – 8.5                                                  0",
        "     8.5 – 9                                                    0",
        "       9 – 10                                                   0",
        "      10 – 12                                                   0",
        "      12 – 16                                                   0",
        "      16 – 24                                                   0",
        "      24 – 32        ██                                        40    4.76%",
    ]


def test_one_among_a_million_is_seen() -> None:
    first, last = histogram([Bin(1.0, 1.1, 999_999), Bin(3.0, 3.1, 1)], DECADE_EDGES)
    assert first.count("█") == BAR_WIDTH
    assert "▏" in last


def test_beyond_the_last_edge() -> None:
    (line,) = histogram([Bin(50.0, 60.0, 3)], (1.0, 2.0))
    assert line.startswith("       2 –           █")


def test_nothing_to_draw() -> None:
    assert list(histogram([], DECADE_EDGES)) == []


def test_colours_change_no_character() -> None:
    bins = [Bin(1.0, 1.1, 5), Bin(3.0, 3.1, 1)]
    coloured = "\n".join(histogram(bins, DECADE_EDGES, ANSI))
    assert ANSI.number in coloured
    assert coloured.replace(ANSI.number, "").replace(ANSI.reset, "") == "\n".join(
        histogram(bins, DECADE_EDGES)
    )


@pytest.mark.parametrize("edges", [edges_around(8.0), edges_around(1.0), DECADE_EDGES])
def test_edges_rise(edges: tuple[float, ...]) -> None:
    assert list(edges) == sorted(set(edges))


@given(st.lists(st.tuples(st.floats(1e-3, 1e5), st.integers(1, 10**7)), max_size=30))
def test_every_value_is_in_a_row_and_no_row_is_wide(values: list[tuple[float, int]]) -> None:
    bins = [Bin(value, value * 1.005, count) for value, count in sorted(values)]
    lines = list(histogram(bins, DECADE_EDGES))
    assert sum(int(line[21 + BAR_WIDTH :].split()[0]) for line in lines) == sum(count for _, count in values)
    assert all(len(line) <= 80 for line in lines)
