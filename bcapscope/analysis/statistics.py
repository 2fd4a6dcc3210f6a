"""Figures of calls, by client and by command: how many, how often, how long, what went wrong."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from bcapscope.analysis.distribution import Distribution, Histogram
from bcapscope.protocol.hresult import is_failure
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation, Endpoint, Transport
from bcapscope.traffic.question import Question
from bcapscope.traffic.verdict import Outcome

MOST_KINDS = 4096
"""Pairs of client and question that have figures of their own; calls of others are counted together as
`OTHERS` of their client."""

MOST_CODES = 16
"""Result codes told apart for one kind of call, the first ones met."""

GRACE_NS = 200_000_000_000
"""How long after the end of a time slice its last calls may settle: a tracker keeps a silent call open for
180 s (`traffic.lane.EXECUTION_NS`)."""

OTHERS = Question(0, None)
"""Stands for all that was asked beyond `MOST_KINDS`; 0 is no function's id."""

ELSEWHERE = Conversation(Endpoint("others", 0), Endpoint("others", 0), Transport.UDP, "")
"""Stands for all clients that came when twice `MOST_KINDS` pairs had figures of their own."""

_TOGETHER = 512
_MILLISECOND = 1_000_000


@dataclass(frozen=True, slots=True)
class Figures:
    """What is known of the calls of one kind, of one client, or of all.

    Attributes:
        calls: in all.
        answered: with a result that is no failure.
        refused: with a failure.
        unanswered: given up by the client.
        open: still open when the traffic ended.
        not_followed: let go while they were open, as more was open than is kept.
        retries: requests sent again.
        retried: calls that were sent more than once.
        late: replies that came too late.
        executing: S_EXECUTING notices.
        request_bytes: of all requests, retries included.
        rate: calls a second over the time of the whole, None for a time of 0.
        share: of the whole time during which the client waited for the reply to such a call; what several
            conversations wait at once adds up.
        latency: milliseconds from the first request to the accepted reply.
        codes: failures by HRESULT, the most frequent first.
    """

    calls: int
    answered: int
    refused: int
    unanswered: int
    open: int
    not_followed: int
    retries: int
    retried: int
    late: int
    executing: int
    request_bytes: int
    rate: float | None
    share: float | None
    latency: Distribution | None
    codes: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Row:
    """Figures of one kind of call.

    Attributes:
        conversation: of which client; None for all.
        question: function and command; None for all of the client.
        figures: of these calls.
    """

    conversation: Conversation | None
    question: Question | None
    figures: Figures


@dataclass(frozen=True, slots=True)
class Statistics:
    """Figures of a time.

    Attributes:
        start: nanoseconds since 1970; of the first request, or where the slice begins.
        end: of the last frame of a call, or where the slice ends.
        total: of all calls.
        clients: of each client, the one that called most first.
        commands: of each kind of call of each client, the one that took most time first.
        kinds: of each kind of call, all clients together, likewise.
    """

    start: int
    end: int
    total: Row
    clients: tuple[Row, ...]
    commands: tuple[Row, ...]
    kinds: tuple[Row, ...]


class _Tally:
    """Counts calls of one kind; smooth ones, nearly all, are counted many at once."""

    __slots__ = (
        "calls", "codes", "executing", "histogram", "late", "latencies",
        "outcomes", "request_bytes", "retried", "retries", "smooth", "waited",
    )  # fmt: skip

    def __init__(self) -> None:
        self.calls = self.retries = self.retried = self.late = self.executing = self.request_bytes = 0
        self.waited = 0
        self.outcomes: Counter[Outcome] = Counter()
        self.codes: Counter[int] = Counter()
        self.histogram = Histogram()
        self.smooth: list[int] = []
        self.latencies: list[int] = []

    def take(self, call: Exchange) -> None:
        request, reply = call.request, call.reply
        self.request_bytes += len(request.item.raw)
        if reply is None or is_failure(reply.item.code) or not call.is_plain:
            self._take_troubled(call)
            return
        smooth = self.smooth
        smooth.append(reply.time - request.time)
        if len(smooth) >= _TOGETHER:
            self.settle()

    def _take_troubled(self, call: Exchange) -> None:
        self.calls += 1
        self.retries += call.retries
        self.retried += call.retries > 0
        self.late += len(call.late_replies)
        self.executing += len(call.notices)
        self.request_bytes += sum(len(seen.item.raw) for seen in call.requests[1:])
        self.outcomes[call.outcome] += 1
        if call.outcome is Outcome.REFUSED:
            self._count_code(call.hresult)
        if call.latency is not None:
            self.latencies.append(call.latency)
            if len(self.latencies) >= _TOGETHER:
                self.settle()

    def _count_code(self, code: int | None) -> None:
        if code is not None and (code in self.codes or len(self.codes) < MOST_CODES):
            self.codes[code] += 1

    def settle(self) -> None:
        """Count the smooth calls kept so far, and move all latencies into the histogram."""
        self.calls += len(self.smooth)
        self.outcomes[Outcome.ANSWERED] += len(self.smooth)
        latencies = self.smooth + self.latencies
        self.waited += sum(latencies)
        self.histogram.add(np.array(latencies, dtype=np.float64) / _MILLISECOND)
        self.smooth, self.latencies = [], []

    def add(self, other: _Tally) -> None:
        """Take over what another tally counted, whose latencies are settled."""
        for name in ("calls", "retries", "retried", "late", "executing", "request_bytes", "waited"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.outcomes.update(other.outcomes)
        self.codes.update(other.codes)
        self.histogram.merge(other.histogram)

    def figures(self, nanoseconds: int) -> Figures:
        """Sum up over a time."""
        self.settle()
        seconds = nanoseconds / 1_000_000_000
        return Figures(
            calls=self.calls,
            answered=self.outcomes[Outcome.ANSWERED],
            refused=self.outcomes[Outcome.REFUSED],
            unanswered=self.outcomes[Outcome.UNANSWERED],
            open=self.outcomes[Outcome.CAPTURE_ENDED],
            not_followed=self.outcomes[Outcome.NOT_FOLLOWED],
            retries=self.retries,
            retried=self.retried,
            late=self.late,
            executing=self.executing,
            request_bytes=self.request_bytes,
            rate=self.calls / seconds if seconds else None,
            share=self.waited / nanoseconds if nanoseconds else None,
            latency=self.histogram.distribution(),
            codes=tuple(sorted(self.codes.items(), key=lambda code: (-code[1], code[0]))),
        )


class Summary:
    """Counts calls as they settle; memory grows with the kinds of calls, not with their number."""

    def __init__(self) -> None:
        self._tallies: dict[tuple[Conversation, Question], _Tally] = {}
        self._conversation: Conversation | None = None
        self._question: Question | None = None
        self._tally: _Tally
        self._start: int | None = None
        self._end = 0

    def take(self, call: Exchange) -> None:
        """Count a call."""
        if call.question is not self._question or call.conversation is not self._conversation:
            self._turn_to(call)
        self._tally.take(call)
        if self._start is None or call.request.time < self._start:
            self._start = call.request.time
        self._end = max(self._end, call.activity)

    def statistics(self, start: int | None = None, end: int | None = None) -> Statistics | None:
        """Sum up; None where there were no calls.

        Args:
            start: where the time begins that rates and shares are of; the first request if not given.
            end: where it ends; the last frame of a call if not given.
        """
        if self._start is None:
            return None
        start, end = self._start if start is None else start, self._end if end is None else end
        span = end - start
        commands = [Row(*key, tally.figures(span)) for key, tally in self._tallies.items()]
        clients: dict[Conversation, _Tally] = {}
        kinds: dict[Question, _Tally] = {}
        total = _Tally()
        for (conversation, question), tally in self._tallies.items():
            for whole in (
                clients.setdefault(conversation, _Tally()),
                kinds.setdefault(question, _Tally()),
                total,
            ):
                whole.add(tally)
        by_client = [Row(conversation, None, tally.figures(span)) for conversation, tally in clients.items()]
        by_kind = [Row(None, question, tally.figures(span)) for question, tally in kinds.items()]
        return Statistics(
            start,
            end,
            Row(None, None, total.figures(span)),
            tuple(sorted(by_client, key=lambda row: -row.figures.calls)),
            tuple(sorted(commands, key=_time_taken)),
            tuple(sorted(by_kind, key=_time_taken)),
        )

    def _turn_to(self, call: Exchange) -> None:
        key = self._conversation, self._question = call.conversation, call.question
        tally = self._tallies.get(key)
        if tally is None:
            if len(self._tallies) >= MOST_KINDS:
                key = call.conversation if len(self._tallies) < 2 * MOST_KINDS else ELSEWHERE, OTHERS
            tally = self._tallies.setdefault(key, _Tally())
        self._tally = tally


def _time_taken(row: Row) -> tuple[float, int]:
    return -(row.figures.share or 0), -row.figures.calls


class Slices:
    """Statistics of one slice of time after the other; a call belongs to the slice in which it started.

    Where time goes back by more than `GRACE_NS`, as between captures read in another order, all slices before
    that are over; a slice may then come twice, each time with other calls.
    """

    def __init__(self, nanoseconds: int) -> None:
        """Cut the time into slices of that length, the first one beginning with the first call."""
        self._length = nanoseconds
        self._origin: int | None = None
        self._latest = 0
        self._over = 0
        self._open: dict[int, Summary] = {}

    def take(self, call: Exchange) -> list[Statistics]:
        """Count a call; return the slices to which nothing can be added any more, in order."""
        time = call.request.time
        if self._origin is None:
            self._origin = self._latest = time
        found = []
        if time < self._latest - GRACE_NS:
            found = self.close()
            self._latest = time
        self._latest = max(self._latest, time)
        over = (self._latest - self._origin - GRACE_NS) // self._length
        if over > self._over:
            found = self._give_out([number for number in self._open if number < over])
        self._over = over
        number = (time - self._origin) // self._length
        summary = self._open.get(number)
        if summary is None:
            summary = self._open[number] = Summary()
        summary.take(call)
        return found

    def close(self) -> list[Statistics]:
        """Return the slices that are left."""
        return self._give_out(list(self._open))

    def _give_out(self, numbers: list[int]) -> list[Statistics]:
        starts = [(number, (self._origin or 0) + number * self._length) for number in sorted(numbers)]
        found = (self._open.pop(number).statistics(start, start + self._length) for number, start in starts)
        return [statistics for statistics in found if statistics is not None]
