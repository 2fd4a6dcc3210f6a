"""Gather the data for a report on captures, in one pass over the traffic and in bounded memory."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, TrafficTotals
from bcapscope.analysis.rules.rule_checker import call_observations
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import Statistics, StatisticsBuilder
from bcapscope.analysis.timeline_events import (
    ACTIVITY_PAUSE_NS,
    MAX_ACTIVITY_PERIODS,
    MAX_EVENTS,
    TimelineEvent,
    TimelineEventKind,
    TimelineEventList,
)
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Conversation, Flow, Observation
from bcapscope.traffic.pipeline import PipelineSubscriber

MAX_TIMELINES = 256

MAX_COUNTED = 65536
"""Maximum number of clients that are counted, but have no timeline."""

MAX_RETRY_CHAINS = 12
"""Maximum number of calls that are shown frame by frame: those with the most retries, then the slowest."""

LARGEST_RETRY_CHAIN = 2 << 20
"""Only calls whose frames have at most this total size in bytes are shown frame by frame."""

MAX_DAMAGED = 20

MAX_DAMAGED_BYTES = 24
"""Number of bytes that are kept from the start of a damaged frame."""

MAX_SESSIONS = 256


class DamagedFrame(NamedTuple):
    """A frame with problems, bytes that are not a frame, or a gap in the capture of a TCP connection.

    Attributes:
        time: Capture time, ns since 1970.
        raw: The first `MAX_DAMAGED_BYTES` bytes; empty for a gap.
        missing_bytes: Size of a gap; otherwise 0.
    """

    frame: int
    time: int
    flow: Flow
    length: int
    raw: bytes
    problems: tuple[Problem, ...]
    missing_bytes: int


@dataclass(frozen=True, slots=True)
class ClientTimeline:
    conversation: Conversation
    calls: int
    activity: tuple[TimelineEvent, ...]
    events: Mapping[TimelineEventKind, tuple[TimelineEvent, ...]]


@dataclass(frozen=True, slots=True)
class ReportData:
    """Data from one or more captures for a report.

    Attributes:
        start: Time of the first frame, ns since 1970.
        end: Time of the last frame, ns since 1970.
        timelines: Timelines of the clients; the client with the most calls comes first.
        slave_sessions_left_off: Number of slave-mode sessions beyond `MAX_SESSIONS`.
        verdicts: Number of calls for each verdict except *answered* and *refused*.
        retry_chains: The calls with the most retries, in chronological order.
    """

    start: int
    end: int
    totals: TrafficTotals
    findings: tuple[Finding, ...]
    statistics: Statistics | None
    timelines: tuple[ClientTimeline, ...]
    timelines_left_off: int
    slave_sessions: tuple[SlaveSession, ...]
    slave_sessions_left_off: int
    verdicts: Mapping[CallVerdict, int]
    retry_chains: tuple[Call, ...]
    retried_calls: int
    stray_replies: int
    damaged_frames: tuple[DamagedFrame, ...]
    damaged_count: int


_Badness: TypeAlias = "tuple[int, int, int]"


class ReportDataBuilder(PipelineSubscriber):
    """Gathers the data for a report. First subscribe `diagnosis` to the pipeline, then this builder."""

    def __init__(self, is_selected: Callable[[Call], bool] | None = None) -> None:
        """The report covers the damaged frames of all calls, selected or not."""
        self._is_selected = is_selected
        self.diagnosis = Diagnosis(is_selected, self._keep_session)
        self._statistics = StatisticsBuilder()
        self._start: int | None = None
        self._end = 0
        self._timelines: dict[Conversation, _TimelineBuilder] = {}
        self._timelines_left_off: set[Conversation] = set()
        self._slave_sessions: list[SlaveSession] = []
        self._sessions_left_off = 0
        self._verdicts: Counter[CallVerdict] = Counter()
        self._retry_chains: list[tuple[_Badness, Call]] = []
        self._retried_calls = self._stray_replies = self._damaged_count = 0
        self._damaged: list[DamagedFrame] = []

    def on_frame(self, observation: Observation) -> None:
        time = observation.time
        if self._start is None or time < self._start:
            self._start = time
        self._end = max(self._end, time)
        if observation.item.__class__ is Malformed:
            self._add_damaged(observation)

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        for seen in call_observations(call):
            self._check_frame(seen)
        if self._is_selected is None or self._is_selected(call):
            self._add_selected(call)

    def on_set_points(self, calls: Sequence[Call]) -> None:
        """Add set points without a check of their frames: `AlikeSetPoints` accepts only undamaged frames."""
        for call in calls:
            if self._is_selected is None or self._is_selected(call):
                self._add_selected(call)

    def on_stray_reply(self, stray: StrayReply) -> None:
        self._stray_replies += 1
        self._check_frame(stray.observation)

    def report_data(self, ended_at: int = 0) -> ReportData | None:
        """Return the data so far; None if no frame was captured. For `ended_at`, see `Diagnosis.findings`."""
        if self._start is None:
            return None
        sessions = [*self._slave_sessions, *self.diagnosis.remaining_sessions(ended_at)]
        timelines = sorted(self._timelines.values(), key=lambda timeline: -timeline.call_count)
        chains = sorted((chain for _, chain in self._retry_chains), key=lambda chain: chain.request.time)
        return ReportData(
            start=self._start,
            end=self._end,
            findings=self.diagnosis.findings(ended_at),
            totals=self.diagnosis.totals(ended_at),
            statistics=self._statistics.statistics(),
            timelines=tuple(timeline.timeline() for timeline in timelines),
            timelines_left_off=len(self._timelines_left_off),
            slave_sessions=tuple(sorted(sessions[:MAX_SESSIONS], key=lambda session: session.number)),
            slave_sessions_left_off=self._sessions_left_off + len(sessions[MAX_SESSIONS:]),
            verdicts=dict(self._verdicts.most_common()),
            retry_chains=tuple(chains),
            retried_calls=self._retried_calls,
            stray_replies=self._stray_replies,
            damaged_frames=tuple(sorted(self._damaged, key=lambda damaged: damaged.frame)),
            damaged_count=self._damaged_count,
        )

    def _add_selected(self, call: Call) -> None:
        self._statistics.add_call(call)
        timeline = self._timeline_of(call.conversation)
        reply = call.reply
        plain = reply is not None and call.is_plain and not reply.item.code
        if timeline is not None:
            timeline.add_call(call, plain)
        if not plain:
            self._on_troubled_call(call)

    def _keep_session(self, session: SlaveSession) -> None:
        if len(self._slave_sessions) < MAX_SESSIONS:
            self._slave_sessions.append(session)
        else:
            self._sessions_left_off += 1

    def _timeline_of(self, conversation: Conversation) -> _TimelineBuilder | None:
        timeline = self._timelines.get(conversation)
        if timeline is None and len(self._timelines) < MAX_TIMELINES:
            timeline = self._timelines[conversation] = _TimelineBuilder(conversation)
        elif timeline is None and len(self._timelines_left_off) < MAX_COUNTED:
            self._timelines_left_off.add(conversation)
        return timeline

    def _on_troubled_call(self, call: Call) -> None:
        verdict = call.verdict
        if verdict not in (CallVerdict.ANSWERED, CallVerdict.REFUSED):
            self._verdicts[verdict] += 1
        retries = call.retries
        if retries:
            self._retried_calls += 1
            if call.memory_bytes > LARGEST_RETRY_CHAIN:
                return
            badness = retries, call.latency or 0, -call.number
            push = heapq.heappushpop if len(self._retry_chains) >= MAX_RETRY_CHAINS else heapq.heappush
            push(self._retry_chains, (badness, call))

    def _check_frame(self, observation: FrameObservation) -> None:
        if observation.item.problems:
            self._add_damaged(observation)

    def _add_damaged(self, observation: Observation | FrameObservation) -> None:
        item = observation.item
        missing = 0 if isinstance(item, Frame) else item.missing
        timeline = self._timeline_of(observation.flow.conversation)
        if timeline is not None:
            kind = TimelineEventKind.MISSING if missing else TimelineEventKind.DAMAGED
            event = TimelineEvent(observation.time, observation.time, 1, observation.number)
            timeline.events[kind].add(event)
        self._damaged_count += 1
        if len(self._damaged) < MAX_DAMAGED:
            about = observation.flow, len(item.raw), item.raw[:MAX_DAMAGED_BYTES], item.problems, missing
            self._damaged.append(DamagedFrame(observation.number, observation.time, *about))


class _TimelineBuilder:
    def __init__(self, conversation: Conversation) -> None:
        self.call_count = 0
        self._conversation = conversation
        self._activity = TimelineEventList(MAX_ACTIVITY_PERIODS, ACTIVITY_PAUSE_NS)
        self.events = defaultdict[TimelineEventKind, TimelineEventList](lambda: TimelineEventList(MAX_EVENTS))

    def add_call(self, call: Call, plain: bool) -> None:
        self.call_count += 1
        request = call.request
        self._activity.add(TimelineEvent(request.time, call.last_activity, 1, request.number))
        if not plain:
            event = TimelineEvent(request.time, request.time, 1, request.number, call.kind, call.hresult)
            for kind in _event_kinds(call):
                self.events[kind].add(event)

    def timeline(self) -> ClientTimeline:
        events = {kind: self.events[kind].all for kind in TimelineEventKind if kind in self.events}
        return ClientTimeline(self._conversation, self.call_count, self._activity.all, events)


def _event_kinds(call: Call) -> Sequence[TimelineEventKind]:
    """Return at most two kinds of events of a call. One kind is the gravest of: executed twice, answered
    late, retried. The other kind is: refused, or unanswered.
    """
    kinds = []
    verdict = call.verdict
    if verdict is CallVerdict.EXECUTED_TWICE:
        kinds.append(TimelineEventKind.EXECUTED_TWICE)
    elif verdict is CallVerdict.REPLY_LATE:
        kinds.append(TimelineEventKind.LATE)
    elif call.retries:
        kinds.append(TimelineEventKind.RETRIED)
    if call.hresult is not None and is_failure(call.hresult):
        kinds.append(TimelineEventKind.REFUSED)
    elif call.reply is None and call.surely_unanswered:
        kinds.append(TimelineEventKind.UNANSWERED)
    return kinds
