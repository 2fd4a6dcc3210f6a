"""Pictures of a stay in slave mode: the pace of the set points, and where they led."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import plotly.graph_objects as go

from bcapscope.analysis.distribution import Distribution
from bcapscope.analysis.moments import SetPointFact
from bcapscope.analysis.motion import AxisMotion
from bcapscope.analysis.samples import Sample
from bcapscope.analysis.stay import ExitReason, Stay
from bcapscope.protocol.hresult import hresult_name
from bcapscope.render.report_figure import (
    AMBER,
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    Bars,
    Picture,
    axis,
    bars_of,
    label,
    numbers,
    picture,
)

_FEW = 400  # so many points can be told apart as dots on a line
_STILL = 1e-9
_COLUMNS = 2
_BETWEEN = 0.12
_NOTABLE_LAG = 0.5


def pace(stay: Stay, start: int) -> Picture | None:
    """Draw cycle, reply time and the buffer's reserve over time; None for a stay without set points."""
    samples = stay.samples
    if not samples:
        return None
    times = _times(samples, start)
    traces = [
        *_cycles(stay, times),
        *_replies(stay, times, start),
        *_reserve(stay, times, start),
        *_gaps(stay, start),
    ]
    timing = stay.timing
    lines = [
        _level("y", timing.grid_ms, GRAY, "dash"),
        _level("y3", 0.0, ORANGE, "dash"),
        *_ending(stay, start),
    ]
    if timing.gaps:
        lines.append(_level("y", timing.slack_ms, ORANGE, "dot"))
    return picture(
        f"pace-{stay.number}",
        f"Stay {stay.number}: pace of the set points",
        f"Top: time since the set point before; the dashed line is the period of {timing.grid_ms:g} ms that "
        f"the client should keep{_slack_words(stay)}. Middle: time from the first request to the reply. "
        "Bottom: time that was left until the controller's buffer would have been empty, by a model of a "
        f"buffer of {stay.buffer.slots}; below the dashed line it was."
        f"{_run_words(samples)}{_first_words(stay)}",
        560,
        traces,
        hovermode="x unified",
        hoversubplots="axis",
        shapes=lines,
        annotations=list(_ending_words(stay, start)),
        xaxis=axis("time since the first frame, s", anchor="y3", hoverformat=".3f"),
        yaxis=axis("cycle, ms", domain=[0.70, 1.0], rangemode="tozero"),
        yaxis2=axis("reply after, ms", domain=[0.35, 0.64], rangemode="tozero"),
        yaxis3=axis("reserve, ms", domain=[0.0, 0.29]),
    )


def spread(stay: Stay) -> Picture | None:
    """Draw histograms of cycles and reply times; None where there are neither."""
    timing = stay.timing
    found = [
        ("cycle, ms", BLUE, timing.cycle),
        ("time to the reply, ms", GREEN, timing.latency),
    ]
    drawn = [(title, color, each) for title, color, each in found if each is not None and each.bins]
    if not drawn:
        return None
    made = [(title, color, each, bars_of(each.bins, each.least, each.most)) for title, color, each in drawn]
    layout: dict[str, Any] = {}
    traces, shapes = [], []
    for index, (title, color, _, bars) in enumerate(made):
        number = "" if index == 0 else str(index + 1)
        domain = _column(index, len(made))
        kind = {"type": "log"} if bars.logarithmic else {}
        layout[f"xaxis{number}"] = axis(title, domain=domain, anchor=f"y{number}", **kind)
        layout[f"yaxis{number}"] = axis(
            "set points", type="log", dtick=1, anchor=f"x{number}", range=_counts_range(bars)
        )
        traces.append(_bars(title, color, bars, number))
        if index == 0 and stay.timing.cycle is not None:
            shapes.append(_upright(f"x{number}", f"y{number}", timing.grid_ms, GRAY))
    return picture(
        f"spread-{stay.number}",
        f"Stay {stay.number}: how often which cycle and which reply time",
        "How many set points came after which time, and were answered after which. Counts are on a "
        "logarithmic axis, so that a single late one is seen beside thousands. The dashed line is the "
        f"period of {timing.grid_ms:g} ms." + _log_words(bars for *_, bars in made),
        340,
        traces,
        shapes=shapes,
        showlegend=False,
        hovermode="closest",
        margin={"l": 64, "r": 18, "t": 16, "b": 48},
        **layout,
    )


def motion(stay: Stay, start: int) -> Picture | None:
    """Draw commanded against returned poses, an axis beside the other; None where nothing moved."""
    if stay.motion is None:
        return None
    moving = [
        (index, each)
        for index, each in enumerate(stay.motion.axes)
        if each.most - each.least > _STILL or _returned_moves(stay.samples, index)
    ]
    if not moving:
        return None
    rows = math.ceil(len(moving) / _COLUMNS)
    still = [each.name for each in stay.motion.axes if each not in [found for _, found in moving]]
    traces: list[Any] = []
    layout: dict[str, Any] = {"annotations": []}
    times = _times(stay.samples, start)
    for place, (index, each) in enumerate(moving):
        number = "" if place == 0 else str(place + 1)
        traces += _axis_lines(stay.samples, times, index, number, place == 0)
        layout |= _axis_layout(place, rows, len(moving), each)
        layout["annotations"].append(_axis_title(each, number))
    return picture(
        f"motion-{stay.number}",
        f"Stay {stay.number}: commanded and returned pose",
        "For each axis the commanded position and the one that came back with the reply. The returned one "
        f"lags behind, since the robot needs time to follow{_lag_words(stay)}."
        + (f" {', '.join(still)} did not move." if still else "")
        + _run_words(stay.samples),
        110 + 210 * rows,
        traces,
        hovermode="x unified",
        margin={"l": 64, "r": 18, "t": 56, "b": 48},
        **layout,
    )


def _times(samples: Sequence[Sample], start: int) -> list[float]:
    return [round((sample.time - start) / 1e9, 6) for sample in samples]


def _runs(samples: Sequence[Sample]) -> int:
    return max(sample.points for sample in samples)


def _run_words(samples: Sequence[Sample]) -> str:
    most = _runs(samples)
    return (
        f" Each point stands for up to {most} set points: the shortest and longest times, the first pose."
        * (most > 1)
    )


def _first_words(stay: Stay) -> str:
    """Say how many of the moments that stand out have a mark."""
    pairs = (
        ("gaps", stay.timing.gaps, len(stay.timing.gap_list)),
        ("times that the buffer ran empty", stay.buffer.starved, len(stay.buffer.starved_list)),
    )
    return "".join(
        f" The first {some} of {everything} {what} are marked."
        for what, everything, some in pairs
        if some < everything
    )


def _slack_words(stay: Stay) -> str:
    if not stay.timing.gaps:
        return ""
    return f", the dotted one the {stay.timing.slack_ms:g} ms that a full buffer lasts"


def _log_words(all_bars: Iterator[Bars]) -> str:
    return " Times that are far apart are on a logarithmic axis too." * any(b.logarithmic for b in all_bars)


def _lag_words(stay: Stay) -> str:
    lag = None if stay.motion is None else stay.motion.lag_cycles
    return "" if lag is None or lag < _NOTABLE_LAG else f"; here by about {lag:.1f} set points"


def _line(name: str, x: list[float], y: list[float | None], color: str, **more: Any) -> Any:
    few = len(x) <= _FEW
    return go.Scatter(
        name=name,
        x=x,
        y=y,
        mode="lines+markers" if few else "lines",
        line={"color": color, "width": 1.4},
        marker={"color": color, "size": 4},
        hovertemplate=f"{name} %{{y:.3f}} ms<extra></extra>",
        **more,
    )


def _cycles(stay: Stay, times: list[float]) -> Iterator[Any]:
    longest = numbers((sample.cycle_most for sample in stay.samples), 4)
    if _runs(stay.samples) == 1:
        yield _line("cycle", times, longest, BLUE)
        return
    shortest = numbers((sample.cycle_least for sample in stay.samples), 4)
    yield _line("shortest cycle", times, shortest, GREEN)
    yield _line("longest cycle", times, longest, BLUE, fill="tonexty")


def _replies(stay: Stay, times: list[float], start: int) -> Iterator[Any]:
    values = numbers((sample.latency_most for sample in stay.samples), 4)
    name = "reply" if _runs(stay.samples) == 1 else "slowest reply"
    yield _line(name, times, values, GREEN, yaxis="y2")
    slow = [fact for fact in stay.timing.slowest if fact.latency_ms is not None]
    if _runs(stay.samples) > 1:
        yield _facts("slowest of all", slow, [fact.latency_ms for fact in slow], start, color=PURPLE, y="y2")


def _gaps(stay: Stay, start: int) -> Iterator[Any]:
    gaps = [fact for fact in stay.timing.gap_list if fact.cycle_ms is not None]
    if gaps:
        yield _facts(
            "longer than a full buffer lasts",
            gaps,
            [fact.cycle_ms for fact in gaps],
            start,
            color=ORANGE,
            y="y",
        )


def _reserve(stay: Stay, times: list[float], start: int) -> Iterator[Any]:
    values = numbers((sample.slack_least for sample in stay.samples), 4)
    name = "reserve" if _runs(stay.samples) == 1 else "smallest reserve"
    yield _line(name, times, values, AMBER, yaxis="y3")
    starved = stay.buffer.starved_list
    if starved:
        yield go.Scatter(
            name="buffer ran empty",
            mode="markers",
            yaxis="y3",
            x=[round((each.time - start) / 1e9, 6) for each in starved],
            y=[0.0] * len(starved),
            marker={"symbol": "x", "color": ORANGE, "size": 9},
            customdata=[[each.missing, each.late_ms, each.before] for each in starved],
            hovertemplate="ran empty for %{customdata[0]} periods; the set point came "
            "%{customdata[1]:.1f} ms late, in frame %{customdata[2]}<extra></extra>",
        )


def _facts(
    name: str,
    found: Sequence[SetPointFact],
    values: Sequence[float | None],
    start: int,
    *,
    color: str,
    y: str,
) -> Any:
    return go.Scatter(
        name=name,
        mode="markers",
        yaxis=y,
        x=[round((fact.time - start) / 1e9, 6) for fact in found],
        y=[None if value is None else round(value, 4) for value in values],
        marker={"symbol": "triangle-up-open", "color": color, "size": 10, "line": {"width": 2}},
        customdata=[[fact.call, fact.request] for fact in found],
        hovertemplate=f"{name}: %{{y:.3f}} ms, call %{{customdata[0]}}, "
        "frame %{customdata[1]}<extra></extra>",
    )


def _level(y: str, value: float, color: str, dash: str) -> dict[str, Any]:
    line = {"color": color, "width": 1.5, "dash": dash}
    return {
        "type": "line",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "yref": y,
        "y0": value,
        "y1": value,
        "line": line,
    }


def _upright(x: str, y: str, value: float, color: str) -> dict[str, Any]:
    line = {"color": color, "width": 1.5, "dash": "dash"}
    at = {"xref": x, "x0": value, "x1": value}
    return {"type": "line", **at, "yref": f"{y} domain", "y0": 0, "y1": 1, "line": line}


def _ending(stay: Stay, start: int) -> Iterator[dict[str, Any]]:
    if stay.exit.reason not in (ExitReason.LEFT, ExitReason.CAPTURE_ENDED):
        at = (stay.exit.time - start) / 1e9
        line = {"color": ORANGE, "width": 1.5}
        yield {"type": "line", "x0": at, "x1": at, "yref": "paper", "y0": 0, "y1": 1, "line": line}


def _ending_words(stay: Stay, start: int) -> Iterator[dict[str, Any]]:
    for line in _ending(stay, start):
        code = "" if not stay.exit.hresult else f", {label(hresult_name(stay.exit.hresult))}"
        words = f"{stay.exit.reason.value}{code}"
        yield {
            "x": line["x0"],
            "yref": "paper",
            "y": 0.67,
            "text": words,
            "showarrow": False,
            "xanchor": "right",
            "xshift": -4,
        }


def _counts_range(bars: Bars) -> list[float]:
    return [math.log10(0.6), math.log10(max(bars.counts) * 1.6)]


def _bars(title: str, color: str, bars: Bars, number: str) -> Any:
    middles = [
        math.sqrt(low * high) if bars.logarithmic else (low + high) / 2
        for low, high in zip(bars.lows, bars.highs, strict=True)
    ]
    return go.Bar(
        name=title,
        x=middles,
        y=bars.counts,
        width=[high - low for low, high in zip(bars.lows, bars.highs, strict=True)],
        marker={"color": color, "line": {"color": color, "width": 1}},
        xaxis=f"x{number}",
        yaxis=f"y{number}",
        customdata=[list(pair) for pair in zip(bars.lows, bars.highs, strict=True)],
        hovertemplate="%{y} set points<br>%{customdata[0]:.4g} to %{customdata[1]:.4g} ms<extra></extra>",
    )


def _returned_moves(samples: Sequence[Sample], index: int) -> bool:
    values = [s.returned[index] for s in samples if math.isfinite(s.returned[index])]
    return bool(values) and max(values) - min(values) > _STILL


def _axis_lines(
    samples: Sequence[Sample], times: list[float], index: int, number: str, first: bool
) -> list[Any]:
    common: dict[str, Any] = {"x": times, "mode": "lines", "xaxis": f"x{number}", "yaxis": f"y{number}"}
    return [
        go.Scatter(
            name="commanded",
            legendgroup="commanded",
            y=numbers(sample.commanded[index] for sample in samples),
            line={"color": BLUE, "width": 2},
            showlegend=first,
            hovertemplate="commanded %{y:.4f}<extra></extra>",
            **common,
        ),
        go.Scatter(
            name="returned",
            legendgroup="returned",
            y=numbers(sample.returned[index] for sample in samples),
            line={"color": ORANGE, "width": 2, "dash": "dot"},
            showlegend=first,
            hovertemplate="returned %{y:.4f}<extra></extra>",
            **common,
        ),
    ]


def _axis_layout(place: int, rows: int, count: int, each: AxisMotion) -> dict[str, Any]:
    row, column = divmod(place, _COLUMNS)
    number = "" if place == 0 else str(place + 1)
    height = 1 / rows
    top = 1 - row * height
    lowest = place + _COLUMNS >= count
    title = "time since the first frame, s" if lowest else ""
    matches = {} if place == 0 else {"matches": "x"}
    return {
        f"xaxis{number}": axis(
            title,
            domain=_column(column, min(_COLUMNS, count)),
            anchor=f"y{number}",
            hoverformat=".3f",
            **matches,
        ),
        f"yaxis{number}": axis(
            f"{each.name}, {each.unit}" if each.unit else each.name,
            domain=[top - height + 0.055, top - 0.05],
            anchor=f"x{number}",
        ),
    }


def _column(column: int, columns: int) -> list[float]:
    """Return from where to where one of so many columns goes, with room for the axis between them."""
    width = (1 - _BETWEEN * (columns - 1)) / columns
    left = column * (width + _BETWEEN)
    return [left, left + width]


def _axis_title(each: AxisMotion, number: str) -> dict[str, Any]:
    largest = each.largest_difference
    words = f"<b>{each.name}</b>"
    if largest is not None:
        words += f"  apart by {largest.value:.3g} {each.unit} at most"
    return {
        "xref": f"x{number} domain",
        "yref": f"y{number} domain",
        "x": 0,
        "y": 1,
        "yanchor": "bottom",
        "xanchor": "left",
        "text": words,
        "showarrow": False,
    }


def percentiles(found: Distribution | None) -> str:
    """Say how values in ms are spread, in one line."""
    if found is None:
        return "none"
    return (
        f"median {found.p50:.3f}, 90% {found.p90:.3f}, 99% {found.p99:.3f}, 99.9% {found.p999:.3f}, "
        f"longest {found.most:.3f} ms"
    )
