"""Pictures of a slave-mode session in a report: the timing of set points, and the motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import plotly.graph_objects as go

from bcapscope.analysis.slave.motion_model import AxisMotion, MotionFacts
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.messages import MessageFormatter
from bcapscope.messages.places import Quantity
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
    marker_trace,
    plotly_label,
    rounded_numbers,
)
from bcapscope.render.slave_session_text import exit_message

_MAX_DOTS = 400  # a line with more points than this is drawn without dots
_LEAST_MOTION = 1e-9
_COLUMNS, _COLUMN_GAP = 2, 0.12
_NOTABLE_LAG = 0.5
_MARGIN = {"l": 64, "r": 18, "t": 56, "b": 48}


def session_pictures(session: SlaveSession, start: int, words: MessageFormatter) -> list[Picture]:
    """Return all pictures that have data. `start` is the time of the first frame in ns since 1970."""
    drawing = _SessionDrawing(session, start, words)
    pictures = drawing.pace(), drawing.spread(), drawing.motion()
    return [picture for picture in pictures if picture is not None]


class _SessionDrawing:
    def __init__(self, session: SlaveSession, start: int, words: MessageFormatter) -> None:
        self._session = session
        self._start = start
        self._words = words
        self._samples = session.samples
        self._times = [self._seconds(sample.time) for sample in session.samples]
        self._points_per_sample = max((sample.points for sample in session.samples), default=1)

    def pace(self) -> Picture | None:
        if not self._samples:
            return None
        timing, words = self._session.timing, self._words
        lines = [
            _horizontal_line("y", timing.grid_ms, GRAY, "dash"),
            _horizontal_line("y3", 0.0, ORANGE, "dash"),
        ]
        if timing.gaps:
            lines.append(_horizontal_line("y", timing.slack_ms, ORANGE, "dot"))
        notes = []
        if self._session.exit.reason not in (ExitReason.LEFT, ExitReason.CAPTURE_ENDED):
            at = self._seconds(self._session.exit.time)
            lines.append(_vertical_line(at, ORANGE))
            notes.append(_note(self._exit_text(), x=at, y=0.67, yref="paper", xanchor="right", xshift=-4))
        return self._picture(
            "pace",
            self._pace_caption(),
            560,
            [*self._cycle_traces(), *self._reply_traces(), *self._reserve_traces()],
            hovermode="x unified",
            hoversubplots="axis",
            shapes=lines,
            annotations=notes,
            xaxis=axis_layout(words("report.axis.time"), anchor="y3", hoverformat=".3f"),
            yaxis=axis_layout(words("report.column.cycle"), domain=[0.70, 1.0], rangemode="tozero"),
            yaxis2=axis_layout(words("report.column.reply-after"), domain=[0.35, 0.64], rangemode="tozero"),
            yaxis3=axis_layout(words("report.axis.reserve"), domain=[0.0, 0.29]),
        )

    def spread(self) -> Picture | None:
        timing, words = self._session.timing, self._words
        has_cycle = timing.cycle is not None and bool(timing.cycle.bins)
        made = [
            (words(title), color, histogram_bars(each.bins, each.least, each.most))
            for title, color, each in (
                ("report.column.cycle", BLUE, timing.cycle),
                ("report.axis.reply-time", GREEN, timing.latency),
            )
            if each is not None and each.bins
        ]
        if not made:
            return None
        layout: dict[str, Any] = {}
        for place, (title, _, bars) in enumerate(made):
            number = _axis_number(place)
            layout[f"xaxis{number}"] = axis_layout(
                title,
                domain=_column(place, len(made)),
                anchor=f"y{number}",
                type="log" if bars.logarithmic else "linear",
            )
            layout[f"yaxis{number}"] = axis_layout(
                words("report.column.set-points"),
                type="log",
                dtick=1,
                anchor=f"x{number}",
                range=[math.log10(0.6), math.log10(max(bars.counts) * 1.6)],
            )
        caption = [words("report.spread.caption", period=Quantity(timing.grid_ms, "ms"))]
        if any(bars.logarithmic for _, _, bars in made):
            caption.append(words("report.spread.log"))
        return self._picture(
            "spread",
            caption,
            340,
            [
                self._bars(title, color, bars, _axis_number(at))
                for at, (title, color, bars) in enumerate(made)
            ],
            shapes=[_vertical_line(timing.grid_ms, GRAY, "dash", "y domain")] if has_cycle else [],
            showlegend=False,
            hovermode="closest",
            margin={**_MARGIN, "t": 16},
            **layout,
        )

    def motion(self) -> Picture | None:
        motion = self._session.motion
        axes = [] if motion is None else list(enumerate(motion.axes))
        moving = [(index, axis) for index, axis in axes if self._moves(index, axis)]
        if motion is None or not moving:
            return None
        rows = math.ceil(len(moving) / _COLUMNS)
        traces: list[Any] = []
        layout: dict[str, Any] = {}
        for place, (index, axis) in enumerate(moving):
            traces += self._axis_traces(index, place)
            layout |= self._axis_layout(place, rows, len(moving), axis)
        return self._picture(
            "motion",
            self._motion_caption(motion, [axis.name for index, axis in axes if (index, axis) not in moving]),
            110 + 210 * rows,
            traces,
            hovermode="x unified",
            margin=_MARGIN,
            annotations=[self._axis_note(axis, _axis_number(at)) for at, (_, axis) in enumerate(moving)],
            **layout,
        )

    def _picture(
        self, kind: str, caption: Iterable[str], height: int, traces: Sequence[Any], **layout: Any
    ) -> Picture:
        number = self._session.number
        title = self._words(f"report.{kind}.title", number=number)
        return make_picture(f"{kind}-{number}", title, " ".join(caption), height, traces, **layout)

    def _seconds(self, time: int) -> float:
        return round((time - self._start) / 1e9, 6)

    def _exit_text(self) -> str:
        reason, code = self._words.text(exit_message(self._session.exit.reason)), self._session.exit.hresult
        return f"{reason}, {plotly_label(hresult_name(code))}" if code else reason

    def _pace_caption(self) -> Iterator[str]:
        timing, buffer, words = self._session.timing, self._session.buffer, self._words
        yield words("report.pace.caption", period=Quantity(timing.grid_ms, "ms"), slots=buffer.slots)
        if timing.gaps:
            yield words("report.pace.slack", slack=Quantity(timing.slack_ms, "ms"))
        yield from self._sampling_note()
        for what, total, shown in (
            ("gaps", timing.gaps, len(timing.gap_list)),
            ("empty", buffer.underflows, len(buffer.underflow_list)),
        ):
            if shown < total:
                yield words(f"report.pace.marked-{what}", shown=shown, total=total)

    def _motion_caption(self, motion: MotionFacts, still: Sequence[str]) -> Iterator[str]:
        yield self._words("report.motion.caption")
        if motion.lag_cycles is not None and motion.lag_cycles >= _NOTABLE_LAG:
            yield self._words("report.motion.lag", cycles=f"{motion.lag_cycles:.1f}")
        if still:
            yield self._words("report.motion.still", axes=", ".join(still))
        yield from self._sampling_note()

    def _sampling_note(self) -> Iterator[str]:
        if self._points_per_sample > 1:
            yield self._words("report.sampled", n=self._points_per_sample)

    def _curve(self, id: str, values: Iterable[float], color: str, **more: Any) -> Any:
        name = self._words(f"report.trace.{id}")
        return go.Scatter(
            name=name,
            x=self._times,
            y=rounded_numbers(values, 4),
            mode="lines+markers" if len(self._times) <= _MAX_DOTS else "lines",
            line={"color": color, "width": 1.4},
            marker={"color": color, "size": 4},
            hovertemplate=f"{name} %{{y:.3f}} ms<extra></extra>",
            **more,
        )

    def _set_point_marks(
        self, id: str, facts: Sequence[tuple[SetPointFact, float | None]], color: str, y: str
    ) -> Iterator[Any]:
        """Yield a trace with a mark for each set point in `facts`. The number beside a set point is a
        duration in ms, such as the cycle time: the height of the mark. A set point with None gets no mark.
        """
        found = [(fact, value) for fact, value in facts if value is not None]
        name = self._words(f"report.trace.{id}")
        texts = [
            self._words("report.hover.set-point", call=fact.call, frame=fact.request_frame)
            for fact, _ in found
        ]
        if found:
            yield marker_trace(
                name,
                [self._seconds(fact.time) for fact, _ in found],
                [round(value, 4) for _, value in found],
                ("triangle-up-open", color),
                [f"{name}: {value:.3f} ms, {text}" for (_, value), text in zip(found, texts, strict=True)],
                yaxis=y,
            )

    def _cycle_traces(self) -> Iterator[Any]:
        longest = [sample.cycle_most for sample in self._samples]
        if self._points_per_sample == 1:
            yield self._curve("cycle", longest, BLUE)
        else:
            yield self._curve("shortest-cycle", (sample.cycle_least for sample in self._samples), GREEN)
            yield self._curve("longest-cycle", longest, BLUE, fill="tonexty")
        gaps = [(fact, fact.cycle_ms) for fact in self._session.timing.gap_list]
        yield from self._set_point_marks("gap", gaps, ORANGE, "y")

    def _reply_traces(self) -> Iterator[Any]:
        slowest = (sample.latency_most for sample in self._samples)
        if self._points_per_sample == 1:
            yield self._curve("reply", slowest, GREEN, yaxis="y2")
            return
        yield self._curve("slowest-reply", slowest, GREEN, yaxis="y2")
        facts = [(fact, fact.latency_ms) for fact in self._session.timing.slowest]
        yield from self._set_point_marks("slowest-of-all", facts, PURPLE, "y2")

    def _reserve_traces(self) -> Iterator[Any]:
        id = "reserve" if self._points_per_sample == 1 else "smallest-reserve"
        yield self._curve(id, (sample.slack_least for sample in self._samples), AMBER, yaxis="y3")
        empty = self._session.buffer.underflow_list
        if empty:
            texts = [
                self._words(
                    "report.hover.empty",
                    cycles=each.missed_ticks,
                    late=Quantity(each.late_ms, "ms", 1),
                    frame=each.late_frame,
                )
                for each in empty
            ]
            times = [self._seconds(each.time) for each in empty]
            name = self._words("report.trace.empty")
            yield marker_trace(name, times, [0.0] * len(empty), ("x", ORANGE), texts, yaxis="y3")

    def _bars(self, title: str, color: str, bars: HistogramBars, number: str) -> Any:
        counts = [self._words.plural("count.set-point", count) for count in bars.counts]
        ranges = [
            self._words("report.hover.range", low=f"{low:.4g}", high=f"{high:.4g}")
            for low, high in bars.edges
        ]
        return go.Bar(
            name=title,
            x=[math.sqrt(low * high) if bars.logarithmic else (low + high) / 2 for low, high in bars.edges],
            y=bars.counts,
            width=[high - low for low, high in bars.edges],
            marker={"color": color, "line": {"color": color, "width": 1}},
            xaxis=f"x{number}",
            yaxis=f"y{number}",
            customdata=[[f"{count}<br>{each}"] for count, each in zip(counts, ranges, strict=True)],
            hovertemplate="%{customdata[0]}<extra></extra>",
        )

    def _moves(self, index: int, axis: AxisMotion) -> bool:
        if axis.most - axis.least > _LEAST_MOTION:
            return True
        values = [each.returned[index] for each in self._samples if math.isfinite(each.returned[index])]
        return bool(values) and max(values) - min(values) > _LEAST_MOTION

    def _axis_traces(self, index: int, place: int) -> Iterator[Any]:
        number = _axis_number(place)
        for id, line, values in (
            ("commanded", {"color": BLUE}, [sample.commanded[index] for sample in self._samples]),
            ("returned", {"color": ORANGE, "dash": "dot"}, [each.returned[index] for each in self._samples]),
        ):
            name = self._words(f"report.trace.{id}")
            yield go.Scatter(
                name=name,
                legendgroup=id,
                x=self._times,
                y=rounded_numbers(values),
                mode="lines",
                line={**line, "width": 2},
                showlegend=place == 0,
                hovertemplate=f"{name} %{{y:.4f}}<extra></extra>",
                xaxis=f"x{number}",
                yaxis=f"y{number}",
            )

    def _axis_layout(self, place: int, rows: int, count: int, axis: AxisMotion) -> dict[str, Any]:
        row, column = divmod(place, _COLUMNS)
        number, top = _axis_number(place), 1 - row / rows
        is_lowest = place + _COLUMNS >= count
        return {
            f"xaxis{number}": axis_layout(
                self._words("report.axis.time") if is_lowest else "",
                domain=_column(column, min(_COLUMNS, count)),
                anchor=f"y{number}",
                hoverformat=".3f",
                **({"matches": "x"} if place else {}),
            ),
            f"yaxis{number}": axis_layout(
                f"{axis.name}, {axis.unit}" if axis.unit else axis.name,
                domain=[top - 1 / rows + 0.055, top - 0.05],
                anchor=f"x{number}",
            ),
        }

    def _axis_note(self, axis: AxisMotion, number: str) -> dict[str, Any]:
        text, largest = f"<b>{axis.name}</b>", axis.largest_difference
        if largest is not None:
            value = Quantity(largest.value, axis.unit)
            text += f"  {self._words('report.motion.difference', value=value)}"
        refs = {"xref": f"x{number} domain", "yref": f"y{number} domain"}
        return _note(text, x=0, y=1, yanchor="bottom", xanchor="left", **refs)


def _axis_number(place: int) -> str:
    """Return what plotly appends to a diagram's axis names: "" for the first diagram, "2" for the second."""
    return "" if place == 0 else str(place + 1)


def _column(column: int, columns: int) -> list[float]:
    """Return the left and right edge of a column of diagrams. The gaps between columns hold axis labels."""
    width = (1 - _COLUMN_GAP * (columns - 1)) / columns
    left = column * (width + _COLUMN_GAP)
    return [left, left + width]


def _note(text: str, **place: Any) -> dict[str, Any]:
    return {"text": text, "showarrow": False, **place}


def _horizontal_line(y: str, value: float, color: str, dash: str) -> dict[str, Any]:
    ends = {"xref": "paper", "x0": 0, "x1": 1, "yref": y, "y0": value, "y1": value}
    return {"type": "line", **ends, "line": {"color": color, "width": 1.5, "dash": dash}}


def _vertical_line(x: float, color: str, dash: str = "solid", y: str = "paper") -> dict[str, Any]:
    ends = {"xref": "x", "x0": x, "x1": x, "yref": y, "y0": 0, "y1": 1}
    return {"type": "line", **ends, "line": {"color": color, "width": 1.5, "dash": dash}}
