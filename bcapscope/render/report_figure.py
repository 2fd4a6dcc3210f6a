"""What all pictures of a report have in common.

Colours are read as well on white as on black, more than three to one (WCAG 2.2, 1.4.11), and are told apart
by the colour-blind (after the set of Okabe and Ito); shapes and dashes say the same once more. Text, axes and
grid get their colours from the page's style sheet, so that one picture serves all themes and paper.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import plotly.graph_objects as go
import plotly.io as pio

from bcapscope.analysis.statistics.distribution import Bin
from bcapscope.render.escape import printable

BLUE, ORANGE, GREEN, PURPLE, AMBER, GRAY = "#2F7FC1", "#CF5C0A", "#0A8F6A", "#B5619A", "#B27A00", "#7A828C"
"""Contrast to white and to #15191D is 3.7 at least."""

LONGEST_LABEL = 48
"""Characters of a string from the wire beside an axis."""

MAX_BARS = 160
"""Bars of a histogram."""

_WIDE_SPREAD = 5.0  # values so far apart, as factors go, are told apart on a logarithmic axis only
_FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', 'Noto Sans JP', sans-serif"


class Picture(NamedTuple):
    """One picture for the page: plain text, height in CSS pixels, and JSON for plotly.js, safe in a script
    element.
    """

    name: str
    title: str
    caption: str
    height: int
    json: str


def plotly_label(text: str, longest: int = LONGEST_LABEL) -> str:
    """Make plain text fit for plotly, which takes some HTML and character references in all its texts."""
    shown = printable(text)
    return html.escape(shown if len(shown) <= longest else shown[: longest - 1] + "…", quote=False)


def make_picture(
    name: str, title: str, caption: str, height: int, traces: Sequence[Any], **layout: Any
) -> Picture:
    """Make a picture of plotly's traces, with a layout beyond what all pictures have."""
    common: dict[str, Any] = {
        "template": "none",
        "height": height,
        "font": {"family": _FONT, "size": 13},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 64, "r": 18, "t": 40, "b": 48},
        "hoverlabel": {
            "bgcolor": "#20262C",
            "font": {"color": "#FFFFFF", "size": 13, "family": _FONT},
            "align": "left",
        },
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1,
            "yref": "container",
            "yanchor": "top",
            "traceorder": "normal",
            "bgcolor": "rgba(0,0,0,0)",
        },
        "bargap": 0,
    }
    made = go.Figure(data=list(traces), layout={**common, **layout})
    text: str = pio.to_json(made, validate=False, engine="orjson")
    return Picture(name, title, caption, height, script_safe(text))


def script_safe(json_text: str) -> str:
    """Rewrite JSON so that no string in it can end a script element, begin a comment or end a line."""
    for char in "<>&\u2028\u2029":
        json_text = json_text.replace(char, f"\\u{ord(char):04x}")
    return json_text


def axis_layout(title: str, **more: Any) -> dict[str, Any]:
    """Describe an axis with its unit in the title."""
    spike = {"spikethickness": 1, "spikecolor": GRAY, "spikedash": "solid"}
    return {"title": {"text": title, "standoff": 8}, "zeroline": False, "automargin": True, **spike, **more}


def rounded_numbers(values: Iterable[float], digits: int = 6) -> list[float | None]:
    """Round values for JSON; None for NaN and infinities, where plotly leaves a gap."""
    return [round(value, digits) if math.isfinite(value) else None for value in values]


class HistogramBars(NamedTuple):
    """Where the bars of a histogram begin and end, and how many values each has."""

    lows: list[float]
    highs: list[float]
    counts: list[int]
    logarithmic: bool


def histogram_bars(bins: Sequence[Bin], least: float, most: float) -> HistogramBars:
    """Combine fine bins, by their middles, into bars of equal width, if need be on a logarithmic axis.

    Bars without values are left out.
    """
    low, high = max(least, bins[0].low), min(most, bins[-1].high)
    spread = low > 0 and high / low > _WIDE_SPREAD
    if spread:
        low, high = math.log(low), math.log(high)
    finest = max((bin_.high - bin_.low for bin_ in bins), default=0.0)
    step = max((high - low) / MAX_BARS, 0.01 if spread else finest) or 1.0
    counts: dict[int, int] = {}
    for bin_ in bins:
        middle = (max(bin_.low, least) + min(bin_.high, most)) / 2
        place = int(((math.log(middle) if spread and middle > 0 else middle) - low) / step)
        counts[place] = counts.get(place, 0) + bin_.count
    edges = [(low + place * step, low + (place + 1) * step) for place in sorted(counts)]
    if spread:
        edges = [(math.exp(begin), math.exp(end)) for begin, end in edges]
    lows, highs = [begin for begin, _ in edges], [end for _, end in edges]
    return HistogramBars(lows, highs, [counts[place] for place in sorted(counts)], spread)
