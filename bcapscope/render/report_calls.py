"""Pictures in a report that show calls: a timeline of the clients, latencies by command, and retries."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import plotly.graph_objects as go

from bcapscope.analysis.report_data import ReportData
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, StatisticsRow
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.analysis.timeline_events import TimelineEvent, TimelineEventKind
from bcapscope.messages import MessageFormatter
from bcapscope.messages.places import Count, HexNumber, Quantity
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.report_figure import (
    AMBER,
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    Picture,
    axis_layout,
    make_picture,
    marker_trace,
    plotly_label,
)
from bcapscope.render.slave_session_text import exit_message
from bcapscope.render.statistics_text import call_kind_text
from bcapscope.traffic.call import Call, FrameRole
from bcapscope.traffic.observation import Conversation

MAX_TIMELINE_ROWS = 16  # rows of the picture: the clients with the most calls

MAX_KINDS = 20  # commands in the picture: those that took the most time in total

_NARROWEST = 0.0015  # minimum width of a bar as a share of the total width; a narrower bar would be invisible
# the picture shows times below 0.001 ms as 0.001 ms, because a logarithmic axis has no 0
_SHORTEST_MS = 0.001

_BAR = "#2A74B2"  # contrast to white text: 4.9:1
_LEAST_FOR_P999 = 100  # with fewer replies than this, the picture has no 99.9% value

_MARKER_STYLES: dict[TimelineEventKind, tuple[str, str, float]] = {
    TimelineEventKind.RETRIED: ("triangle-up-open", AMBER, 0.26),
    TimelineEventKind.LATE: ("triangle-down", PURPLE, 0.36),
    TimelineEventKind.EXECUTED_TWICE: ("star", PURPLE, 0.36),
    TimelineEventKind.REFUSED: ("x", ORANGE, 0.46),
    TimelineEventKind.UNANSWERED: ("circle-open", ORANGE, 0.46),
    TimelineEventKind.DAMAGED: ("diamond", GRAY, 0.46),
    TimelineEventKind.MISSING: ("line-ns-open", GRAY, 0.46),
}
_FRAME_STYLES: dict[FrameRole, tuple[str, str]] = {
    FrameRole.REQUEST: ("triangle-right", BLUE),
    FrameRole.RETRY: ("triangle-right-open", AMBER),
    FrameRole.NOTICE: ("diamond-open", GRAY),
    FrameRole.REPLY: ("circle", GREEN),
    FrameRole.LATE: ("x", ORANGE),
    FrameRole.LOST: ("circle-x-open", ORANGE),
    FrameRole.DUPLICATE: ("square-open", GRAY),
    FrameRole.CAPTURED_AGAIN: ("square-open", GRAY),
}


def timeline_picture(report_data: ReportData, words: MessageFormatter) -> Picture:
    """Draw one row per client, with its calls, slave-mode sessions and events."""
    return _TimelineDrawing(report_data, words).picture()


def latency_picture(rows: Sequence[StatisticsRow], words: MessageFormatter) -> Picture | None:
    answered = [(row, row.figures.latency) for row in rows if row.figures.latency is not None]
    if not answered:
        return None
    found = answered[:MAX_KINDS][::-1]
    names = [plotly_label(call_kind_text(row.call_kind or OTHER_KINDS, words)) for row, _ in found]
    texts = [
        f"{name}<br>{_latency_text(row, latency, words)}"
        for name, (row, latency) in zip(names, found, strict=True)
    ]
    points = [
        [max(value, _SHORTEST_MS) for value in (each.least, each.p50, each.p99, each.p999, each.most)]
        for _, each in found
    ]
    counts = [latency.count for _, latency in found]

    def dots(id: str, column: int, look: tuple[str, str], least: int = 1) -> Any:
        at = [index for index, count in enumerate(counts) if count >= least]
        values = [points[index][column] for index in at]
        return marker_trace(words(f"report.trace.{id}"), values, at, look, [texts[index] for index in at])

    def bars(id: str, first: int, last: int, color: str, width: float) -> Any:
        lines = [(index, each[first], each[last]) for index, each in enumerate(points)]
        return _segments(words(f"report.trace.{id}"), lines, color, width)

    traces = [
        bars("extremes", 0, 4, GRAY, 2),
        bars("median-to-99", 1, 2, BLUE, 9),
        dots("median", 1, ("circle", BLUE)),
        dots("p999", 3, ("diamond", PURPLE), _LEAST_FOR_P999),
        dots("longest", 4, ("line-ns-open", ORANGE), 2),
    ]
    left_off = len(answered) - len(found)
    more = f" {words('report.latencies.more', n=left_off)}" if left_off else ""
    return make_picture(
        "latencies",
        words("report.latencies.title"),
        words("report.latencies.caption") + more,
        130 + 30 * len(found),
        traces,
        hovermode="closest",
        xaxis=axis_layout(words("report.axis.reply-time"), type="log", dtick=1),
        yaxis=_row_axis(names, -0.7, len(found) - 0.3),
    )


def _latency_text(row: StatisticsRow, latency: DistributionSummary, words: MessageFormatter) -> str:
    answered = words("report.hover.answered", answered=latency.count, calls=row.figures.calls)
    places = {"p50": latency.p50, "p99": latency.p99, "p999": latency.p999}
    percentiles = words("report.hover.percentiles", **{id: f"{each:.3f}" for id, each in places.items()})
    extremes = words("report.hover.range", low=f"{latency.least:.3f}", high=f"{latency.most:.3f}")
    return f"{answered}<br>{percentiles}<br>{extremes}"


def retry_chain_picture(report_data: ReportData, words: MessageFormatter) -> Picture | None:
    """Draw the frames of the calls with the most retries. Return None if no call has retries."""
    if not report_data.retry_chains:
        return None
    found = report_data.retry_chains[::-1]
    roles = [
        role for role in _FRAME_STYLES if any(event.role is role for call in found for event in call.frames)
    ]
    lasting = [
        (index, 0.0, (call.last_activity - call.request.time) / 1e6) for index, call in enumerate(found)
    ]
    longest = max((end for _, _, end in lasting), default=0.0) or 1.0
    traces = [_segments("", lasting, GRAY, 1), *(_role_trace(found, role, words) for role in roles)]
    left_off = report_data.retried_calls - len(found)
    which = (
        words("report.chains.some", shown=len(found), n=left_off) if left_off else words("report.chains.all")
    )
    labels = [
        words(
            "report.chains.call", number=call.number, kind=plotly_label(call_kind_text(call.kind, words), 32)
        )
        for call in found
    ]
    return make_picture(
        "chains",
        words("report.chains.title"),
        f"{words('report.chains.caption')} {which}",
        130 + 34 * len(found),
        traces,
        hovermode="closest",
        xaxis=axis_layout(words("report.axis.request-time"), range=[-0.02 * longest, 1.04 * longest]),
        yaxis=_row_axis(labels, -0.7, len(found) - 0.3),
    )


def _row_axis(labels: Sequence[str], low: float, high: float, step: int = 1) -> dict[str, Any]:
    """Return a vertical axis with the `labels` at 0, `step`, 2 * `step` and so on."""
    return {
        "tickvals": [index * step for index in range(len(labels))],
        "ticktext": labels,
        "range": [low, high],
        "showgrid": False,
        "zeroline": False,
        "automargin": True,
        "fixedrange": True,
    }


def _endpoints_label(conversation: Conversation) -> str:
    return (
        f"{plotly_label(str(conversation.client))}<br>→ {plotly_label(str(conversation.server))} "
        f"{conversation.transport.upper()}"
    )


class _TimelineDrawing:
    def __init__(self, report_data: ReportData, words: MessageFormatter) -> None:
        self._data = report_data
        self._words = words
        self._timelines = report_data.timelines[:MAX_TIMELINE_ROWS]

    def picture(self) -> Picture:
        data, words, count = self._data, self._words, len(self._timelines)
        lasted = self._seconds(data.end) or 1.0
        left_off = len(data.timelines) + data.timelines_left_off - count
        more = f" {words('report.timeline.more', n=left_off)}" if left_off else ""
        labels = [_endpoints_label(timeline.conversation) for timeline in self._timelines]
        return make_picture(
            "timeline",
            words("report.timeline.title"),
            words("report.timeline.caption") + more,
            130 + 76 * count,
            [self._activity_bars(), *self._slave_session_bars(), *self._event_markers()],
            barmode="overlay",
            uniformtext={"minsize": 11, "mode": "hide"},
            hovermode="closest",
            xaxis=axis_layout(words("report.axis.time"), range=[-0.01 * lasted, 1.01 * lasted]),
            yaxis=_row_axis(labels, 0.62 - count, 0.62, -1),
        )

    def _seconds(self, time: int) -> float:
        return round((time - self._data.start) / 1e9, 6)

    def _activity_bars(self) -> Any:
        bars, texts = [], []
        for index, timeline in enumerate(self._timelines):
            for each in timeline.activity:
                bars.append((-index, each.begin, each.end))
                text = self._words(
                    "report.hover.calls",
                    calls=Count(each.occurrences, "call"),
                    duration=Quantity((each.end - each.begin) / 1e9, "s", 3),
                    start=Quantity(self._seconds(each.begin), "s", 3),
                )
                texts.append(text)
        return self._time_bars(self._words("report.trace.calls"), bars, texts, (GRAY, 0.12))

    def _slave_session_bars(self) -> Iterator[Any]:
        words, name = self._words, self._words("report.trace.slave-mode")
        rows = {timeline.conversation: -index for index, timeline in enumerate(self._timelines)}
        bars, texts, labels = [], [], []
        for each in self._data.slave_sessions:
            if each.conversation not in rows:
                continue
            end = each.entered_at + round(each.duration_ms * 1e6)
            bars.append((rows[each.conversation], each.entered_at, end))
            value = each.mode.value
            mode = name if value is None else words("report.trace.mode", mode=HexNumber(value, 3))
            labels.append(f"{each.number}: {mode}")
            figures = words(
                "report.hover.session",
                points=Count(each.counts.sent, "set-point"),
                duration=Quantity(each.duration_ms / 1e3, "s", 3),
                start=Quantity(self._seconds(each.entered_at), "s", 3),
            )
            reason = words.text(exit_message(each.exit.reason))
            texts.append(f"{words('report.label.session')} {each.number}: {mode}<br>{figures}<br>{reason}")
        if bars:
            yield self._time_bars(
                name,
                bars,
                texts,
                (_BAR, 0.34),
                text=labels,
                textposition="inside",
                insidetextanchor="middle",
                insidetextfont={"color": "#FFFFFF"},
                textangle=0,
            )

    def _time_bars(
        self,
        name: str,
        periods: Sequence[tuple[int, int, int]],
        texts: Sequence[str],
        look: tuple[str, float],
        **more: Any,
    ) -> Any:
        """Draw horizontal bars. Each period has a row, a start and an end, both times in ns since 1970."""
        least = max((self._data.end - self._data.start) / 1e9 * _NARROWEST, 1e-6)
        color, width = look
        return go.Bar(
            name=name,
            orientation="h",
            y=[row for row, _, _ in periods],
            base=[self._seconds(begin) for _, begin, _ in periods],
            x=[max(round((end - begin) / 1e9, 6), least) for _, begin, end in periods],
            width=width,
            marker={"color": color, "line": {"width": 0}},
            customdata=[[text] for text in texts],
            hovertemplate="%{customdata[0]}<extra></extra>",
            **more,
        )

    def _event_markers(self) -> Iterator[Any]:
        for kind, (symbol, color, above) in _MARKER_STYLES.items():
            found = [
                (above - index, event)
                for index, timeline in enumerate(self._timelines)
                for event in timeline.events.get(kind, ())
            ]
            if found:
                yield marker_trace(
                    self._words.text(kind.message),
                    [self._seconds(event.begin) for _, event in found],
                    [row for row, _ in found],
                    (symbol, color),
                    [self._event_text(kind, event) for _, event in found],
                )

    def _event_text(self, kind: TimelineEventKind, event: TimelineEvent) -> str:
        words, id, text = self._words, "report.hover.frame", self._words.text(kind.message)
        if event.occurrences > 1:
            id = "report.hover.first-frame"
            text = words("report.hover.events", n=event.occurrences, kind=kind.message)
        if event.call_kind is not None:
            text = f"{plotly_label(call_kind_text(event.call_kind, words))}: {text}"
        if event.hresult is not None and kind is TimelineEventKind.REFUSED:
            meaning = plotly_label(words.text(describe_hresult(event.hresult).meaning), 80)
            text += f"<br>{plotly_label(hresult_name(event.hresult))}, {meaning}"
        at = Quantity(self._seconds(event.begin), "s", 3)
        return f"{text}<br>{words(id, frame=event.frame, time=at)}"


def _segments(name: str, lines: Sequence[tuple[int, float, float]], color: str, width: float) -> Any:
    """Draw horizontal lines. `lines` contains y, first x and last x of each line."""
    return go.Scatter(
        name=name,
        mode="lines",
        x=[value for _, begin, end in lines for value in (begin, end, None)],
        y=[value for at, _, _ in lines for value in (at, at, None)],
        line={"color": color, "width": width},
        hoverinfo="skip",
        showlegend=bool(name),
    )


def _role_trace(calls: Sequence[Call], role: FrameRole, words: MessageFormatter) -> Any:
    name = words(f"frame.role.{role.replace(' ', '-')}")
    found = [
        (index, call, event.observation)
        for index, call in enumerate(calls)
        for event in call.frames
        if event.role is role
    ]
    delays = [(seen.time - call.request.time) / 1e6 for _, call, seen in found]
    texts = []
    for delay, (_, call, seen) in zip(delays, found, strict=True):
        text = f"{plotly_label(call_kind_text(call.kind, words))}: {name}"
        if role not in (FrameRole.REQUEST, FrameRole.RETRY):
            text += f", {plotly_label(hresult_name(seen.item.code))}"
        after = words("report.hover.after-request", delay=Quantity(delay, "ms", 3))
        numbers = {"frame": seen.number, "serial": seen.item.serial, "reserved": seen.item.reserved}
        texts.append(f"{text}<br>{after}<br>{words('report.hover.frame-fields', **numbers)}")
    return marker_trace(name, delays, [index for index, _, _ in found], _FRAME_STYLES[role], texts)
