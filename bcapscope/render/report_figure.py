"""Colours, layout and helper functions that all pictures of a report share.

The colours are based on the set of Okabe and Ito, so that colour-blind readers can distinguish them. Lines
and marks of different colours also differ in shape or dashes. The style sheet of the page sets the colours of
text, axes and grid, so the same picture fits light and dark themes and paper.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import plotly.graph_objects as go
import plotly.io as pio

from bcapscope.analysis.statistics.distribution_summary import Bin
from bcapscope.render.escape import printable

BLUE, ORANGE, GREEN, PURPLE, AMBER, GRAY = "#2F7FC1", "#CF5C0A", "#0A8F6A", "#B5619A", "#B27A00", "#7A828C"
"""Each colour has a contrast of 3.7:1 or more to white and to #15191D. WCAG 2.2 (1.4.11) requires 3:1."""

LONGEST_LABEL = 48  # maximum number of characters of a label

MAX_BARS = 160  # bars of a histogram

_WIDE_SPREAD = 5.0  # an axis is logarithmic if the ratio of largest to smallest value is above this
_FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', 'Noto Sans JP', sans-serif"


class Picture(NamedTuple):
    """`height` is in CSS pixels. `json` is the data for plotly.js; it is safe inside a script element."""

    name: str
    title: str
    caption: str
    height: int
    json: str


def plotly_label(text: str, longest: int = LONGEST_LABEL) -> str:
    """Escape and shorten plain text for plotly. Escaping is needed because plotly interprets some HTML."""
    shown = printable(text)
    return html.escape(shown if len(shown) <= longest else shown[: longest - 1] + "…", quote=False)


def make_picture(
    name: str, title: str, caption: str, height: int, traces: Sequence[Any], **layout: Any
) -> Picture:
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
    """Escape JSON so that its strings cannot end a script element, begin a comment or end a line."""
    for char in "<>&\u2028\u2029":
        json_text = json_text.replace(char, f"\\u{ord(char):04x}")
    return json_text


def marker_trace(
    name: str,
    x: Sequence[float],
    y: Sequence[float],
    look: tuple[str, str],
    texts: Sequence[str],
    **more: Any,
) -> Any:
    """Draw a mark at each point. `look` has the symbol and the colour. `texts` appear under the pointer."""
    symbol, color = look
    return go.Scatter(
        name=name,
        mode="markers",
        x=x,
        y=y,
        marker={"symbol": symbol, "color": color, "size": 10, "line": {"width": 2, "color": color}},
        customdata=[[text] for text in texts],
        hovertemplate="%{customdata[0]}<extra></extra>",
        **more,
    )


def axis_layout(title: str, **more: Any) -> dict[str, Any]:
    spike = {"spikethickness": 1, "spikecolor": GRAY, "spikedash": "solid"}
    return {"title": {"text": title, "standoff": 8}, "zeroline": False, "automargin": True, **spike, **more}


def rounded_numbers(values: Iterable[float], digits: int = 6) -> list[float | None]:
    """Replace NaN and infinities with None, which plotly shows as a gap."""
    return [round(value, digits) if math.isfinite(value) else None for value in values]


class HistogramBars(NamedTuple):
    edges: list[tuple[float, float]]
    counts: list[int]
    logarithmic: bool


def histogram_bars(bins: Sequence[Bin], least: float, most: float) -> HistogramBars:
    """Combine narrow bins into wider bars of equal width, and omit bars without values. The middle of a bin
    decides which bar gets its count. If the values span a large range, the widths are equal on a logarithmic
    axis."""
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
    return HistogramBars(edges, [counts[place] for place in sorted(counts)], spread)
