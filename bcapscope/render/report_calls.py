"""Pictures of calls in a report: a timeline of the clients, latencies by command, and retries."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import plotly.graph_objects as go

from bcapscope.analysis.report_data import ClientTimeline, ReportData
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, StatisticsRow
from bcapscope.analysis.timeline_events import TimelineEvent, TimelineEventKind
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
    plotly_label,
)
from bcapscope.render.statistics_text import call_kind_text
from bcapscope.traffic.call import Call, CallFrame, FrameRole
from bcapscope.traffic.observation import Conversation

MAX_TIMELINE_ROWS = 16
"""Maximum number of clients in the timeline: those that made the most calls."""

MAX_KINDS = 20
"""Maximum number of commands in the picture of latencies: those that took the most time."""

_NARROWEST = 0.0015  # minimum width of a bar, as a share of the total width, so that it is visible
_SHORTEST_MS = 0.001  # a logarithmic axis has no 0; clocks of captures are no finer than this

_BAR = "#2A74B2"  # contrast to white text: 4.9:1
_LEAST_FOR_P999 = 100  # minimum number of replies for which a 99.9% value is shown

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
_FRAME_NAMES = {FrameRole.NOTICE: "S_EXECUTING", FrameRole.LATE: "late reply, discarded"}


def timeline_picture(report_data: ReportData) -> Picture:
    """Return the timeline, with a row of calls, slave-mode sessions and events for each client."""
    timelines = report_data.timelines[:MAX_TIMELINE_ROWS]
    rows = {timeline.conversation: -index for index, timeline in enumerate(timelines)}
    drawn = [session for session in report_data.slave_sessions if session.conversation in rows]
    traces = [
        _activity_bars(report_data, timelines),
        *_slave_session_bars(report_data, drawn, rows),
        *_event_markers(report_data, timelines),
    ]
    lasted = _seconds(report_data, report_data.end) or 1.0
    left_off = len(report_data.timelines) + report_data.timelines_left_off - len(timelines)
    return make_picture(
        "timeline",
        "Who did what, and when",
        "Each row is a client. Thin bars show its calls, thick bars its slave-mode sessions. "
        "Marks above the bars show events. In a long capture, one mark can stand for several events; the "
        "text of the mark gives their number."
        + (f" {left_off} more clients made fewer calls." if left_off else ""),
        130 + 76 * len(timelines),
        traces,
        barmode="overlay",
        uniformtext={"minsize": 11, "mode": "hide"},
        hovermode="closest",
        xaxis=axis_layout("time since the first frame, s", range=[-0.01 * lasted, 1.01 * lasted]),
        yaxis=_row_axis(
            [endpoints_label(timeline.conversation) for timeline in timelines],
            0.62 - len(timelines),
            0.62,
            -1,
        ),
    )


def latency_picture(rows: Sequence[StatisticsRow]) -> Picture | None:
    """Return the picture of latencies by command, or None if no call was answered."""
    kinds = [
        (plotly_label(call_kind_text(row.call_kind or OTHER_KINDS)), row.figures.calls, row.figures.latency)
        for row in rows
        if row.figures.latency is not None
    ]
    if not kinds:
        return None
    shown = kinds[:MAX_KINDS][::-1]
    found = [(name, calls, latency) for name, calls, latency in shown if latency is not None]
    points = [
        (
            index,
            [max(value, _SHORTEST_MS) for value in (each.least, each.p50, each.p99, each.p999, each.most)],
        )
        for index, (_, _, each) in enumerate(found)
    ]
    some = [(at, v) for at, v in points if found[at][2].count > 1]
    many = [(at, v) for at, v in points if found[at][2].count >= _LEAST_FOR_P999]
    texts = [
        f"{name}<br>{each.count} of {calls} answered<br>median {each.p50:.3f} ms, 99% {each.p99:.3f} ms, "
        f"99.9% {each.p999:.3f} ms<br>from {each.least:.3f} to {each.most:.3f} ms"
        for name, calls, each in found
    ]
    traces = [
        _segments("shortest to longest", [(at, v[0], v[4]) for at, v in points], GRAY, 2),
        _segments("median to 99%", [(at, v[1], v[2]) for at, v in points], BLUE, 9),
        _dots("median", [(at, v[1]) for at, v in points], "circle", BLUE, texts),
        _dots("99.9%", [(at, v[3]) for at, v in many], "diamond", PURPLE, [texts[at] for at, _ in many]),
        _dots(
            "longest", [(at, v[4]) for at, v in some], "line-ns-open", ORANGE, [texts[at] for at, _ in some]
        ),
    ]
    more = len(kinds) - len(shown)
    return make_picture(
        "latencies",
        "Time to the reply, by command",
        "Time from the first request to the accepted reply, including retries. Commands that took the most "
        "time are at the top. The axis is logarithmic: each step to the right is ten times as long."
        + (f" {more} more commands took less time." if more else ""),
        130 + 30 * len(found),
        traces,
        hovermode="closest",
        xaxis=axis_layout("time to the reply, ms", type="log", dtick=1),
        yaxis=_row_axis([name for name, _, _ in found], -0.7, len(found) - 0.3),
    )


def retry_chain_picture(report_data: ReportData) -> Picture | None:
    """Return the picture of the calls with the most retries and of their frames, or None without retries."""
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
    traces = [_segments("", lasting, GRAY, 1), *(_role_trace(found, role) for role in roles)]
    more = report_data.retried_calls - len(found)
    return make_picture(
        "chains",
        "Retry chains",
        "Each line is one call, from its first request, with all its captured frames. "
        + (
            f"These are the {len(found)} calls with the most retries; {more} more calls have retries."
            if more
            else "These are all calls with retries."
        ),
        130 + 34 * len(found),
        traces,
        hovermode="closest",
        xaxis=axis_layout("time since the first request, ms", range=[-0.02 * longest, 1.04 * longest]),
        yaxis=_row_axis(
            [f"call {call.number}, {plotly_label(call_kind_text(call.kind), 32)}" for call in found],
            -0.7,
            len(found) - 0.3,
        ),
    )


def _row_axis(labels: Sequence[str], low: float, high: float, step: int = 1) -> dict[str, Any]:
    """Return the plotly layout of a vertical axis with labelled rows at 0, `step`, 2 * `step` and so on."""
    return {
        "tickvals": [index * step for index in range(len(labels))],
        "ticktext": labels,
        "range": [low, high],
        "showgrid": False,
        "zeroline": False,
        "automargin": True,
        "fixedrange": True,
    }


def endpoints_label(conversation: Conversation) -> str:
    """Return a label of two lines with the endpoints of a conversation: client, then controller."""
    return (
        f"{plotly_label(str(conversation.client))}<br>→ {plotly_label(str(conversation.server))} "
        f"{conversation.transport.upper()}"
    )


def _seconds(report_data: ReportData, time: int) -> float:
    return round((time - report_data.start) / 1e9, 6)


def _least_width(report_data: ReportData) -> float:
    return max((report_data.end - report_data.start) / 1e9 * _NARROWEST, 1e-6)


def _activity_bars(report_data: ReportData, timelines: Sequence[ClientTimeline]) -> Any:
    periods = [(-index, period) for index, timeline in enumerate(timelines) for period in timeline.activity]
    least = _least_width(report_data)
    return go.Bar(
        name="calls",
        orientation="h",
        y=[row for row, _ in periods],
        base=[_seconds(report_data, period.begin) for _, period in periods],
        x=[max(round((period.end - period.begin) / 1e9, 6), least) for _, period in periods],
        width=0.12,
        marker={"color": GRAY, "line": {"width": 0}},
        customdata=[[period.occurrences, (period.end - period.begin) / 1e9] for _, period in periods],
        hovertemplate="%{customdata[0]} calls in %{customdata[1]:.3f} s, from %{base:.3f} s<extra></extra>",
    )


def _slave_session_bars(
    report_data: ReportData, slave_sessions: Sequence[SlaveSession], rows: dict[Conversation, int]
) -> Iterator[Any]:
    if not slave_sessions:
        return
    least = _least_width(report_data)
    values = [
        "slave mode" if session.mode.value is None else f"mode 0x{session.mode.value:03X}"
        for session in slave_sessions
    ]
    yield go.Bar(
        name="slave mode",
        orientation="h",
        y=[rows[session.conversation] for session in slave_sessions],
        base=[_seconds(report_data, session.entered_at) for session in slave_sessions],
        x=[max(round(session.duration_ms / 1e3, 6), least) for session in slave_sessions],
        width=0.34,
        marker={"color": _BAR, "line": {"width": 0}},
        text=[f"{session.number}: {value}" for session, value in zip(slave_sessions, values, strict=True)],
        textposition="inside",
        insidetextanchor="middle",
        insidetextfont={"color": "#FFFFFF"},
        textangle=0,
        customdata=[
            [session.number, value, session.counts.sent, session.duration_ms / 1e3, session.exit.reason.value]
            for session, value in zip(slave_sessions, values, strict=True)
        ],
        hovertemplate="session %{customdata[0]}, %{customdata[1]}<br>%{customdata[2]} set points in "
        "%{customdata[3]:.3f} s from %{base:.3f} s<br>ended: %{customdata[4]}<extra></extra>",
    )


def _event_markers(report_data: ReportData, timelines: Sequence[ClientTimeline]) -> Iterator[Any]:
    for kind, (symbol, color, above) in _MARKER_STYLES.items():
        found = [
            (-index, mark)
            for index, timeline in enumerate(timelines)
            for mark in timeline.events.get(kind, ())
        ]
        if found:
            yield go.Scatter(
                name=str(kind.message),
                mode="markers",
                x=[_seconds(report_data, mark.begin) for _, mark in found],
                y=[row + above for row, _ in found],
                marker={"symbol": symbol, "color": color, "size": 9, "line": {"width": 1.6, "color": color}},
                customdata=[[_event_marker_text(kind, mark)] for _, mark in found],
                hovertemplate="%{customdata[0]}<br>at %{x:.3f} s<extra></extra>",
            )


def _event_marker_text(kind: TimelineEventKind, mark: TimelineEvent) -> str:
    text = str(kind.message) if mark.occurrences == 1 else f"{mark.occurrences} times {kind.message}"
    if mark.call_kind is not None:
        text = f"{plotly_label(call_kind_text(mark.call_kind))}: {text}"
    if mark.hresult is not None and kind is TimelineEventKind.REFUSED:
        meaning = plotly_label(describe_hresult(mark.hresult).text, 80)
        text += f"<br>{plotly_label(hresult_name(mark.hresult))}, {meaning}"
    return f"{text}<br>{'frame' if mark.occurrences == 1 else 'first in frame'} {mark.frame}"


def _segments(name: str, lines: Sequence[tuple[int, float, float]], color: str, width: float) -> Any:
    """Return a plotly trace of horizontal lines; each has a height, a start and an end."""
    return go.Scatter(
        name=name,
        mode="lines",
        x=[value for _, begin, end in lines for value in (begin, end, None)],
        y=[value for at, _, _ in lines for value in (at, at, None)],
        line={"color": color, "width": width},
        hoverinfo="skip",
        showlegend=bool(name),
    )


def _dots(name: str, dots: Sequence[tuple[int, float]], symbol: str, color: str, texts: Sequence[str]) -> Any:
    return go.Scatter(
        name=name,
        mode="markers",
        x=[value for _, value in dots],
        y=[at for at, _ in dots],
        marker={"symbol": symbol, "color": color, "size": 10, "line": {"width": 2.4, "color": color}},
        customdata=[[text] for text in texts],
        hovertemplate="%{customdata[0]}<extra></extra>",
    )


def _role_trace(calls: Sequence[Call], role: FrameRole) -> Any:
    """Return a plotly trace of all frames that have this role in their calls."""
    symbol, color = _FRAME_STYLES[role]
    found = [
        (index, call, event)
        for index, call in enumerate(calls)
        for event in call.frames
        if event.role is role
    ]
    dots = [(index, (event.observation.time - call.request.time) / 1e6) for index, call, event in found]
    texts = [_event_text(call, event) for _, call, event in found]
    return _dots(_FRAME_NAMES.get(role, role.value), dots, symbol, color, texts)


def _event_text(call: Call, event: CallFrame) -> str:
    seen = event.observation
    elapsed = (seen.time - call.request.time) / 1e6
    name = _FRAME_NAMES.get(event.role, event.role.value)
    result = (
        ""
        if event.role in (FrameRole.REQUEST, FrameRole.RETRY)
        else f", {plotly_label(hresult_name(seen.item.code))}"
    )
    return (
        f"{plotly_label(call_kind_text(call.kind))}: {name}{result}"
        f"<br>{elapsed:.3f} ms after the first request"
        f"<br>frame {seen.number}, serial {seen.item.serial}, reserved {seen.item.reserved}"
    )
