"""Figures of calls for each client and command: number, rate, latency and failures."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bcapscope.analysis.statistics.distribution import Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.analysis.statistics.place_delays import PlaceFigures, PlaceTally
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import Outcome
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport
from bcapscope.traffic.pipeline import PipelineSubscriber

MAX_KINDS = 4096
"""Maximum number of pairs of client and call kind that are counted separately. All further call kinds of a
client are counted together as `OTHER_KINDS`.
"""

MAX_CODES = 16
"""Maximum number of result codes that are counted for each kind of call."""

GRACE_NS = 200_000_000_000
"""Time in ns from the end of a time slice until all calls of the slice are complete. If a call gets no
further frame, a tracker keeps the call open for 180 s (`pairing_windows.EXECUTION_NS`).
"""

OTHER_KINDS = CallKind(0, None)
"""Stands for all call kinds that are not counted separately. No function has the id 0."""

OTHER_CLIENTS = Conversation(Endpoint("others", 0), Endpoint("others", 0), Transport.UDP, SERVER_PORT)
"""Stands for several clients whose calls are counted together. After `2 * MAX_KINDS` pairs of client and call
kind, the calls of all further pairs count as calls of `OTHER_CLIENTS`.
"""

_FLUSH_AT = 512
_MILLISECOND = 1_000_000


@dataclass(frozen=True, slots=True)
class CallFigures:
    """Figures of a group of calls: of one kind, of one client, or of all calls.

    Attributes:
        answered: Number of calls whose accepted reply reports success.
        unanswered: Number of calls that the client gave up.
        open: Number of calls still open when the traffic ended.
        not_followed: Number of calls that were evicted from memory, because too many calls were open.
        not_captured: Number of calls whose reply the capture lacks (see `Outcome.NOT_CAPTURED`).
        request_bytes: Size of all requests in bytes, including retries.
        calls_per_second: None if the period has no length.
        line_time_share: Sum of the latencies divided by the length of the period; None if the length is 0;
            more than 1 if several conversations wait at the same time.
        latency: Time from the first request to the accepted reply, ms; None if no call was answered.
        refusal_codes: HRESULTs of failures, and the number of calls with each; the most frequent first.
    """

    calls: int
    answered: int
    refused: int
    unanswered: int
    open: int
    not_followed: int
    not_captured: int
    retries: int
    retried_calls: int
    late_replies: int
    executing: int
    request_bytes: int
    calls_per_second: float | None
    line_time_share: float | None
    latency: DistributionSummary | None
    refusal_codes: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class StatisticsRow:
    """Figures of calls. `conversation` is None for all clients; `call_kind` is None for all kinds."""

    conversation: Conversation | None
    call_kind: CallKind | None
    figures: CallFigures


@dataclass(frozen=True, slots=True)
class Statistics:
    """Figures of all calls in a period of time.

    Attributes:
        start: Start of the period, ns since 1970: time of the first request, or start of the slice.
        end: End of the period, ns since 1970: time of the last frame of a call, or end of the slice.
        clients: One row per client; the client with the most calls comes first.
        commands: One row per kind of call and client; the longest total latency comes first.
        kinds: One row per kind of call over all clients; the longest total latency comes first.
        places: Figures of each conversation that was captured at two places.
    """

    start: int
    end: int
    total: StatisticsRow
    clients: tuple[StatisticsRow, ...]
    commands: tuple[StatisticsRow, ...]
    kinds: tuple[StatisticsRow, ...]
    places: tuple[PlaceFigures, ...] = ()


class _CallTally:
    """Counts calls of one kind. For speed, `flush` counts many successful calls at once."""

    def __init__(self) -> None:
        self.calls = self.retries = self.retried = self.late = self.executing = self.request_bytes = 0
        self.waited = 0
        self.outcomes: Counter[Outcome] = Counter()
        self.codes: Counter[int] = Counter()
        self.histogram = Histogram()
        self.smooth_latencies: list[int] = []
        self.other_latencies: list[int] = []

    def add_call(self, call: Call) -> None:
        request, reply = call.request, call.reply
        self.request_bytes += len(request.item.raw)
        if reply is None or is_failure(reply.item.code) or not call.is_plain:
            self._add_troubled(call)
            return
        smooth = self.smooth_latencies
        smooth.append(reply.time - request.time)
        if len(smooth) >= _FLUSH_AT:
            self.flush()

    def _add_troubled(self, call: Call) -> None:
        self.calls += 1
        self.retries += call.retries
        self.retried += call.retries > 0
        self.late += len(call.late_replies)
        self.executing += len(call.notices)
        self.request_bytes += sum(len(seen.item.raw) for seen in call.attempts[1:])
        self.outcomes[call.outcome] += 1
        if call.outcome is Outcome.REFUSED:
            self._count_code(call.hresult)
        if call.latency is not None:
            self.other_latencies.append(call.latency)
            if len(self.other_latencies) >= _FLUSH_AT:
                self.flush()

    def _count_code(self, code: int | None) -> None:
        if code is not None and (code in self.codes or len(self.codes) < MAX_CODES):
            self.codes[code] += 1

    def flush(self) -> None:
        self.calls += len(self.smooth_latencies)
        self.outcomes[Outcome.ANSWERED] += len(self.smooth_latencies)
        latencies = self.smooth_latencies + self.other_latencies
        self.waited += sum(latencies)
        self.histogram.add(np.array(latencies, dtype=np.float64) / _MILLISECOND)
        self.smooth_latencies, self.other_latencies = [], []

    def merge(self, other: _CallTally) -> None:
        """Add the counts of `other`. Call `other.flush` first."""
        for name in ("calls", "retries", "retried", "late", "executing", "request_bytes", "waited"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.outcomes.update(other.outcomes)
        self.codes.update(other.codes)
        self.histogram.merge(other.histogram)

    def figures(self, nanoseconds: int) -> CallFigures:
        self.flush()
        seconds = nanoseconds / 1_000_000_000
        return CallFigures(
            calls=self.calls,
            answered=self.outcomes[Outcome.ANSWERED],
            refused=self.outcomes[Outcome.REFUSED],
            unanswered=self.outcomes[Outcome.UNANSWERED],
            open=self.outcomes[Outcome.CAPTURE_ENDED],
            not_followed=self.outcomes[Outcome.NOT_FOLLOWED],
            not_captured=self.outcomes[Outcome.NOT_CAPTURED],
            retries=self.retries,
            retried_calls=self.retried,
            late_replies=self.late,
            executing=self.executing,
            request_bytes=self.request_bytes,
            calls_per_second=self.calls / seconds if seconds else None,
            line_time_share=self.waited / nanoseconds if nanoseconds else None,
            latency=self.histogram.distribution(),
            refusal_codes=tuple(sorted(self.codes.items(), key=lambda code: (-code[1], code[0]))),
        )


class StatisticsBuilder(PipelineSubscriber):
    """Counts completed calls. The memory grows with the number of call kinds, not of calls."""

    def __init__(self, is_selected: Callable[[Call], bool] | None = None) -> None:
        self._is_selected = is_selected
        self._tallies: dict[tuple[Conversation, CallKind], _CallTally] = {}
        self._conversation: Conversation | None = None
        self._kind: CallKind | None = None
        self._tally: _CallTally
        self._places: dict[Conversation, PlaceTally] = {}
        self._start: int | None = None
        self._end = 0

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if self._is_selected is not None and not self._is_selected(call):
            return
        if call.kind is not self._kind or call.conversation is not self._conversation:
            self._select_tally(call)
        self._tally.add_call(call)
        if isinstance(call.request, JoinedObservation):
            self._add_to_places(call)
        if self._start is None or call.request.time < self._start:
            self._start = call.request.time
        self._end = max(self._end, call.last_activity)

    def _add_to_places(self, call: Call) -> None:
        places = self._places.get(call.conversation)
        if places is None:
            if len(self._places) >= MAX_KINDS:
                return
            places = self._places[call.conversation] = PlaceTally(call.conversation)
        places.add_call(call)

    def add_call(self, call: Call) -> None:
        self.on_call(call, None)

    def statistics(self, start: int | None = None, end: int | None = None) -> Statistics | None:
        """Return the figures so far; None if no call was counted. The rates refer to the period from `start`
        to `end`, in ns since 1970. By default, this period covers all counted calls.
        """
        if self._start is None:
            return None
        start, end = self._start if start is None else start, self._end if end is None else end
        span = end - start
        commands = [StatisticsRow(*key, tally.figures(span)) for key, tally in self._tallies.items()]
        wholes: dict[tuple[Conversation | None, CallKind | None], _CallTally] = {}
        for (conversation, kind), tally in self._tallies.items():
            for group in ((conversation, None), (None, kind), (None, None)):
                wholes.setdefault(group, _CallTally()).merge(tally)
        total = StatisticsRow(None, None, wholes.pop((None, None)).figures(span))
        rows = [StatisticsRow(*group, tally.figures(span)) for group, tally in wholes.items()]
        clients = [row for row in rows if row.call_kind is None]
        kinds = [row for row in rows if row.call_kind is not None]
        return Statistics(
            start,
            end,
            total,
            tuple(sorted(clients, key=lambda row: -row.figures.calls)),
            tuple(sorted(commands, key=_time_taken)),
            tuple(sorted(kinds, key=_time_taken)),
            tuple(places.figures() for places in self._places.values()),
        )

    def _select_tally(self, call: Call) -> None:
        key = self._conversation, self._kind = call.conversation, call.kind
        tally = self._tallies.get(key)
        if tally is None:
            if len(self._tallies) >= MAX_KINDS:
                key = call.conversation if len(self._tallies) < 2 * MAX_KINDS else OTHER_CLIENTS, OTHER_KINDS
            tally = self._tallies.setdefault(key, _CallTally())
        self._tally = tally


def _time_taken(row: StatisticsRow) -> tuple[float, int]:
    return -(row.figures.line_time_share or 0), -row.figures.calls


class SlicedStatistics:
    """Computes the statistics of calls for each slice of time. The start of a call determines its slice.

    Captures are not always read in chronological order. If the start times of the calls jump back by more
    than `GRACE_NS`, `add_call` returns all unfinished slices. If a call starts in a slice that was already
    returned, `add_call` begins a second slice for the same period.
    """

    def __init__(self, nanoseconds: int) -> None:
        self._length = nanoseconds
        self._origin: int | None = None
        self._latest = 0
        self._finished_until = 0
        self._builders = defaultdict[int, StatisticsBuilder](StatisticsBuilder)

    def add_call(self, call: Call) -> list[Statistics]:
        """Count a call; return the slices of time that are now complete, earliest first."""
        time = call.request.time
        if self._origin is None:
            self._origin = self._latest = time
        found = []
        if time < self._latest - GRACE_NS:
            found = self.close()
            self._latest = time
        self._latest = max(self._latest, time)
        over = (self._latest - self._origin - GRACE_NS) // self._length
        if over > self._finished_until:
            found = self._finish_slices([number for number in self._builders if number < over])
        self._finished_until = over
        self._builders[(time - self._origin) // self._length].add_call(call)
        return found

    def close(self) -> list[Statistics]:
        return self._finish_slices(list(self._builders))

    def _finish_slices(self, numbers: list[int]) -> list[Statistics]:
        starts = [(number, (self._origin or 0) + number * self._length) for number in sorted(numbers)]
        found = (
            self._builders.pop(number).statistics(start, start + self._length) for number, start in starts
        )
        return [statistics for statistics in found if statistics is not None]
