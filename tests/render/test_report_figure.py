"""What all pictures of a report have in common."""

from __future__ import annotations

import html
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.statistics.distribution import Histogram
from bcapscope.render.escape import printable
from bcapscope.render.report_figure import (
    AMBER,
    BLUE,
    GRAY,
    GREEN,
    MAX_BARS,
    ORANGE,
    PURPLE,
    histogram_bars,
    make_picture,
    plotly_label,
    rounded_numbers,
    script_safe,
)


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours as WCAG 2.2 reckons it."""

    def luminance(color: str) -> float:
        parts = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("ground", ["#FFFFFF", "#15191D"])
def test_colours_are_seen_on_both_grounds(ground: str) -> None:
    for color in (BLUE, ORANGE, GREEN, PURPLE, AMBER, GRAY):
        assert contrast(color, ground) > 3.6


@given(st.text(max_size=40))
def test_labels_have_no_markup(text: str) -> None:
    made = plotly_label(text, 1000)
    assert "<" not in made
    assert html.unescape(made) == printable(text)


def test_long_labels_are_cut_and_say_so() -> None:
    assert plotly_label("&" * 100, 5) == "&amp;" * 4 + "…"


@given(st.text())
def test_json_cannot_end_its_script(text: str) -> None:
    whole = json.dumps({"text": text}, ensure_ascii=False)
    safe = script_safe(whole)
    assert not set("<>&\u2028\u2029") & set(safe)
    assert json.loads(safe) == {"text": text}


def test_a_picture_is_json() -> None:
    made = make_picture(
        "a", "A", "About.", 200, [{"type": "scatter", "x": [1.0, 2.0], "y": rounded_numbers([math.nan, 3])}]
    )
    read = json.loads(made.json)
    assert read["layout"]["height"] == made.height == 200
    assert read["data"][0]["y"] == [None, 3]


def test_what_plotly_does_not_know_is_refused() -> None:
    with pytest.raises(ValueError, match="nonsense"):
        make_picture("a", "A", "", 200, [], nonsense=1)


def test_numbers_that_are_none_leave_a_gap() -> None:
    assert rounded_numbers([1.23456789, math.nan, math.inf, -math.inf]) == [1.234568, None, None, None]


@given(st.lists(st.floats(0, 1e9), min_size=1, max_size=300))
def test_bars_hold_every_value(values: list[float]) -> None:
    histogram = Histogram()
    histogram.add(np.array(values, dtype=np.float64))
    found = histogram.distribution(bins=True)
    assert found is not None
    bars = histogram_bars(found.bins, found.least, found.most)
    assert sum(bars.counts) == len(values)
    assert len(bars.counts) <= MAX_BARS + 1
    assert all(low < high for low, high in bars.edges)
    assert bars.edges == sorted(bars.edges)
    assert bars.edges[0][0] <= max(found.least, found.bins[0].high)
    assert bars.logarithmic == (found.least > 0 and found.most > 5 * found.least) or len(found.bins) == 1


def test_bars_are_equally_wide() -> None:
    histogram = Histogram()
    histogram.add(np.array([7.9, 8.0, 8.1, 8.2]))
    found = histogram.distribution(bins=True)
    assert found is not None
    bars = histogram_bars(found.bins, found.least, found.most)
    widths = {round(high - low, 9) for low, high in bars.edges}
    assert not bars.logarithmic
    assert len(widths) == 1
