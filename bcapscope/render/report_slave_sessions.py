"""Pictures of a slave-mode session in a report: the timing of set points, and the motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import plotly.graph_objects as go

from bcapscope.analysis.slave.motion_model import AxisMotion
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.plot_samples import PlotSample
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.report_figure import (
    AMBER,
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    HistogramBars,
    Picture,
    axis_layout,
    histogram_bars,
    make_picture,
    plotly_label,
    rounded_numbers,
)

_MAX_DOTS = 400  # maximum number of points that are visible as dots on a line
_LEAST_MOTION = 1e-9
_COLUMNS, _COLUMN_GAP = 2, 0.12
_NOTABLE_LAG = 0.5


def session_pictures(slave_session: SlaveSession, start: int) -> list[Picture]:
    """Return all pictures of a slave-mode session; `start` is the time of the first frame."""
    drawn = (
        pace_picture(slave_session, start),
        spread_picture(slave_session),
        motion_picture(slave_session, start),
    )
    return [picture for picture in drawn if picture is not None]


def pace_picture(slave_session: SlaveSession, start: int) -> Picture | None:
    """Return the picture of cycle time, latency and buffer reserve over time, or None without set points."""
    samples = slave_session.samples
    if not samples:
        return None
    times = _times(samples, start)
    traces = [
        *_cycles(slave_session, times),
        *_replies(slave_session, times, start),
        *_reserve(slave_session, times, start),
        *_gaps(slave_session, start),
    ]
    timing = slave_session.timing
    lines = [
        _horizontal_line("y", timing.grid_ms, GRAY, "dash"),
        _horizontal_line("y3", 0.0, ORANGE, "dash"),
        *_end_line(slave_session, start),
    ]
    if timing.gaps:
        lines.append(_horizontal_line("y", timing.slack_ms, ORANGE, "dot"))
    return make_picture(
        f"pace-{slave_session.number}",
        f"Session {slave_session.number}: timing of the set points",
        "Top: time since the previous set point. The dashed line is the nominal cycle time of "
        f"{timing.grid_ms:g} ms{_slack_note(slave_session)}. "
        "Middle: time from the first request to the reply. "
        "Bottom: time left until the controller's buffer runs empty, estimated by a model with "
        f"{slave_session.buffer.slots} slots. Below the dashed line, the buffer is empty."
        f"{_sampling_note(samples)}{_marks_note(slave_session)}",
        560,
        traces,
        hovermode="x unified",
        hoversubplots="axis",
        shapes=lines,
        annotations=list(_end_annotations(slave_session, start)),
        xaxis=axis_layout("time since the first frame, s", anchor="y3", hoverformat=".3f"),
        yaxis=axis_layout("cycle, ms", domain=[0.70, 1.0], rangemode="tozero"),
        yaxis2=axis_layout("reply after, ms", domain=[0.35, 0.64], rangemode="tozero"),
        yaxis3=axis_layout("reserve, ms", domain=[0.0, 0.29]),
    )


def spread_picture(slave_session: SlaveSession) -> Picture | None:
    """Return histograms of cycle times and latencies, or None without values."""
    timing = slave_session.timing
    found = [
        ("cycle, ms", BLUE, timing.cycle),
        ("time to the reply, ms", GREEN, timing.latency),
    ]
    drawn = [(title, color, each) for title, color, each in found if each is not None and each.bins]
    if not drawn:
        return None
    made = [
        (title, color, each, histogram_bars(each.bins, each.least, each.most)) for title, color, each in drawn
    ]
    layout: dict[str, Any] = {}
    traces, shapes = [], []
    for index, (title, color, _, bars) in enumerate(made):
        number = "" if index == 0 else str(index + 1)
        domain = _column(index, len(made))
        kind = {"type": "log"} if bars.logarithmic else {}
        layout[f"xaxis{number}"] = axis_layout(title, domain=domain, anchor=f"y{number}", **kind)
        layout[f"yaxis{number}"] = axis_layout(
            "set points",
            type="log",
            dtick=1,
            anchor=f"x{number}",
            range=[math.log10(0.6), math.log10(max(bars.counts) * 1.6)],
        )
        traces.append(_bars(title, color, bars, number))
        if index == 0 and slave_session.timing.cycle is not None:
            shapes.append(_vertical_line(f"x{number}", f"y{number}", timing.grid_ms, GRAY))
    return make_picture(
        f"spread-{slave_session.number}",
        f"Session {slave_session.number}: distribution of cycle times and reply times",
        "Number of set points by cycle time and by time to the reply. The vertical axis is "
        "logarithmic, so that a single late set point is visible. The dashed line is the "
        f"nominal cycle time of {timing.grid_ms:g} ms." + _log_axis_note(bars for *_, bars in made),
        340,
        traces,
        shapes=shapes,
        showlegend=False,
        hovermode="closest",
        margin={"l": 64, "r": 18, "t": 16, "b": 48},
        **layout,
    )


def motion_picture(slave_session: SlaveSession, start: int) -> Picture | None:
    """Return the picture of commanded and returned positions for each axis, or None if no axis moved."""
    if slave_session.motion is None:
        return None
    moving = [
        (index, each)
        for index, each in enumerate(slave_session.motion.axes)
        if each.most - each.least > _LEAST_MOTION or _returned_moves(slave_session.samples, index)
    ]
    if not moving:
        return None
    rows = math.ceil(len(moving) / _COLUMNS)
    still = [each.name for each in slave_session.motion.axes if each not in [found for _, found in moving]]
    traces: list[Any] = []
    layout: dict[str, Any] = {"annotations": []}
    times = _times(slave_session.samples, start)
    for place, (index, each) in enumerate(moving):
        number = "" if place == 0 else str(place + 1)
        traces += _axis_lines(slave_session.samples, times, index, number, place == 0)
        layout |= _axis_layout(place, rows, len(moving), each)
        layout["annotations"].append(_axis_title(each, number))
    return make_picture(
        f"motion-{slave_session.number}",
        f"Session {slave_session.number}: commanded and returned pose",
        "Commanded position of each axis, and the position in the reply. The returned position "
        f"lags behind, because the robot needs time to follow{_lag_note(slave_session)}."
        + (f" {', '.join(still)} did not move." if still else "")
        + _sampling_note(slave_session.samples),
        110 + 210 * rows,
        traces,
        hovermode="x unified",
        margin={"l": 64, "r": 18, "t": 56, "b": 48},
        **layout,
    )


def _times(samples: Sequence[PlotSample], start: int) -> list[float]:
    return [round((sample.time - start) / 1e9, 6) for sample in samples]


def _points_per_sample(samples: Sequence[PlotSample]) -> int:
    return max(sample.points for sample in samples)


def _sampling_note(samples: Sequence[PlotSample]) -> str:
    most = _points_per_sample(samples)
    return (
        f" Each point stands for up to {most} set points: their shortest and longest times, the first pose."
        * (most > 1)
    )


def _marks_note(slave_session: SlaveSession) -> str:
    """Return a sentence that says how many gaps and underflows have a mark, if not all have one."""
    pairs = (
        ("gaps", slave_session.timing.gaps, len(slave_session.timing.gap_list)),
        (
            "times that the buffer ran empty",
            slave_session.buffer.underflows,
            len(slave_session.buffer.underflow_list),
        ),
    )
    return "".join(
        f" The first {some} of {everything} {what} are marked."
        for what, everything, some in pairs
        if some < everything
    )


def _slack_note(slave_session: SlaveSession) -> str:
    if not slave_session.timing.gaps:
        return ""
    return f", the dotted line marks the {slave_session.timing.slack_ms:g} ms that a full buffer lasts"


def _log_axis_note(all_bars: Iterator[HistogramBars]) -> str:
    return " The axis of a large time range is also logarithmic." * any(b.logarithmic for b in all_bars)


def _lag_note(slave_session: SlaveSession) -> str:
    lag = None if slave_session.motion is None else slave_session.motion.lag_cycles
    return "" if lag is None or lag < _NOTABLE_LAG else f": in this session by about {lag:.1f} set points"


def _line_trace(name: str, x: list[float], y: list[float | None], color: str, **more: Any) -> Any:
    few = len(x) <= _MAX_DOTS
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


def _cycles(slave_session: SlaveSession, times: list[float]) -> Iterator[Any]:
    longest = rounded_numbers((sample.cycle_most for sample in slave_session.samples), 4)
    if _points_per_sample(slave_session.samples) == 1:
        yield _line_trace("cycle", times, longest, BLUE)
        return
    shortest = rounded_numbers((sample.cycle_least for sample in slave_session.samples), 4)
    yield _line_trace("shortest cycle", times, shortest, GREEN)
    yield _line_trace("longest cycle", times, longest, BLUE, fill="tonexty")


def _replies(slave_session: SlaveSession, times: list[float], start: int) -> Iterator[Any]:
    values = rounded_numbers((sample.latency_most for sample in slave_session.samples), 4)
    name = "reply" if _points_per_sample(slave_session.samples) == 1 else "slowest reply"
    yield _line_trace(name, times, values, GREEN, yaxis="y2")
    slow = [fact for fact in slave_session.timing.slowest if fact.latency_ms is not None]
    if _points_per_sample(slave_session.samples) > 1:
        yield _marker_trace(
            "slowest of all", slow, [fact.latency_ms for fact in slow], start, color=PURPLE, y="y2"
        )


def _gaps(slave_session: SlaveSession, start: int) -> Iterator[Any]:
    gaps = [fact for fact in slave_session.timing.gap_list if fact.cycle_ms is not None]
    if gaps:
        yield _marker_trace(
            "longer than a full buffer lasts",
            gaps,
            [fact.cycle_ms for fact in gaps],
            start,
            color=ORANGE,
            y="y",
        )


def _reserve(slave_session: SlaveSession, times: list[float], start: int) -> Iterator[Any]:
    values = rounded_numbers((sample.slack_least for sample in slave_session.samples), 4)
    name = "reserve" if _points_per_sample(slave_session.samples) == 1 else "smallest reserve"
    yield _line_trace(name, times, values, AMBER, yaxis="y3")
    starved = slave_session.buffer.underflow_list
    if starved:
        yield go.Scatter(
            name="buffer ran empty",
            mode="markers",
            yaxis="y3",
            x=[round((each.time - start) / 1e9, 6) for each in starved],
            y=[0.0] * len(starved),
            marker={"symbol": "x", "color": ORANGE, "size": 9},
            customdata=[[each.missed_ticks, each.late_ms, each.late_frame] for each in starved],
            hovertemplate="empty for %{customdata[0]} cycles; the set point came "
            "%{customdata[1]:.1f} ms late, in frame %{customdata[2]}<extra></extra>",
        )


def _marker_trace(
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
        customdata=[[fact.call, fact.request_frame] for fact in found],
        hovertemplate=f"{name}: %{{y:.3f}} ms, call %{{customdata[0]}}, "
        "frame %{customdata[1]}<extra></extra>",
    )


def _horizontal_line(y: str, value: float, color: str, dash: str) -> dict[str, Any]:
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


def _vertical_line(x: str, y: str, value: float, color: str) -> dict[str, Any]:
    line = {"color": color, "width": 1.5, "dash": "dash"}
    at = {"xref": x, "x0": value, "x1": value}
    return {"type": "line", **at, "yref": f"{y} domain", "y0": 0, "y1": 1, "line": line}


def _end_line(slave_session: SlaveSession, start: int) -> Iterator[dict[str, Any]]:
    if slave_session.exit.reason not in (ExitReason.LEFT, ExitReason.CAPTURE_ENDED):
        at = (slave_session.exit.time - start) / 1e9
        line = {"color": ORANGE, "width": 1.5}
        yield {"type": "line", "x0": at, "x1": at, "yref": "paper", "y0": 0, "y1": 1, "line": line}


def _end_annotations(slave_session: SlaveSession, start: int) -> Iterator[dict[str, Any]]:
    for line in _end_line(slave_session, start):
        code = (
            ""
            if not slave_session.exit.hresult
            else f", {plotly_label(hresult_name(slave_session.exit.hresult))}"
        )
        words = f"{slave_session.exit.reason.value}{code}"
        yield {
            "x": line["x0"],
            "yref": "paper",
            "y": 0.67,
            "text": words,
            "showarrow": False,
            "xanchor": "right",
            "xshift": -4,
        }


def _bars(title: str, color: str, bars: HistogramBars, number: str) -> Any:
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


def _returned_moves(samples: Sequence[PlotSample], index: int) -> bool:
    values = [s.returned[index] for s in samples if math.isfinite(s.returned[index])]
    return bool(values) and max(values) - min(values) > _LEAST_MOTION


def _axis_lines(
    samples: Sequence[PlotSample], times: list[float], index: int, number: str, first: bool
) -> list[Any]:
    common: dict[str, Any] = {"x": times, "mode": "lines", "xaxis": f"x{number}", "yaxis": f"y{number}"}
    return [
        go.Scatter(
            name="commanded",
            legendgroup="commanded",
            y=rounded_numbers(sample.commanded[index] for sample in samples),
            line={"color": BLUE, "width": 2},
            showlegend=first,
            hovertemplate="commanded %{y:.4f}<extra></extra>",
            **common,
        ),
        go.Scatter(
            name="returned",
            legendgroup="returned",
            y=rounded_numbers(sample.returned[index] for sample in samples),
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
        f"xaxis{number}": axis_layout(
            title,
            domain=_column(column, min(_COLUMNS, count)),
            anchor=f"y{number}",
            hoverformat=".3f",
            **matches,
        ),
        f"yaxis{number}": axis_layout(
            f"{each.name}, {each.unit}" if each.unit else each.name,
            domain=[top - height + 0.055, top - 0.05],
            anchor=f"x{number}",
        ),
    }


def _column(column: int, columns: int) -> list[float]:
    """Return the left and right edge of a column of diagrams; columns have space for an axis between them."""
    width = (1 - _COLUMN_GAP * (columns - 1)) / columns
    left = column * (width + _COLUMN_GAP)
    return [left, left + width]


def _axis_title(each: AxisMotion, number: str) -> dict[str, Any]:
    largest = each.largest_difference
    words = f"<b>{each.name}</b>"
    if largest is not None:
        words += f"  largest difference {largest.value:.3g} {each.unit}"
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
