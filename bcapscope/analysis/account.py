"""All that a report tells of captures, gathered in one pass in memory that is bounded."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, Seen
from bcapscope.analysis.marks import MOST_MARKS, MOST_SPELLS, PAUSE_NS, Mark, MarkKind, Marks
from bcapscope.analysis.rules.rule import all_seen
from bcapscope.analysis.statistics import Statistics, Summary
from bcapscope.analysis.stay import Stay
from bcapscope.protocol.arguments import Problem
from bcapscope.protocol.frame import Frame, Malformed
from bcapscope.protocol.hresult import is_failure
from bcapscope.traffic.exchange import Exchange, FrameObservation, Settled, Stray
from bcapscope.traffic.observation import Conversation, Flow, Observation
from bcapscope.traffic.verdict import Verdict

MOST_LANES = 256
"""Clients with a lane of their own."""

MOST_COUNTED = 65536
"""Clients without a lane that are counted."""

MOST_CHAINS = 12
"""Calls of which every frame is told: the ones that were sent again most often, of those the slowest."""

LARGEST_CHAIN = 2 << 20
"""Bytes of a call's frames beyond which its chain is counted and not shown."""

MOST_DAMAGED = 20
"""Damaged frames that are told one by one, the first ones."""

MOST_BYTES = 24
"""Bytes of a damaged frame that are kept."""

MOST_STAYS = 256
"""Stays in slave mode that are kept; further ones are counted."""


class Damaged(NamedTuple):
    """A frame with problems, or bytes that are no frame.

    Attributes:
        frame: its number.
        time: nanoseconds since 1970.
        flow: who spoke to whom.
        length: bytes there are.
        raw: the first of them.
        problems: what is wrong.
        missing: bytes that are missing in a stream at that place.
    """

    frame: int
    time: int
    flow: Flow
    length: int
    raw: bytes
    problems: tuple[Problem, ...]
    missing: int


@dataclass(frozen=True, slots=True)
class Lane:
    """One client over time.

    Attributes:
        conversation: between whom.
        calls: how many.
        spells: when it made calls, and how many.
        marks: what happened, by kind.
    """

    conversation: Conversation
    calls: int
    spells: tuple[Mark, ...]
    marks: Mapping[MarkKind, tuple[Mark, ...]]


@dataclass(frozen=True, slots=True)
class Account:
    """What captures hold.

    Attributes:
        start: time of the first frame, nanoseconds since 1970.
        end: of the last.
        seen: how much there was.
        findings: of all rules, the first cause first.
        statistics: None where there are no calls.
        lanes: the clients that called most first.
        lanes_left_off: clients without a lane.
        stays: in slave mode, in the order in which they began.
        stays_left_off: stays beyond those.
        verdicts: calls that were not just answered or refused, by what they suffered.
        chains: the worst of those that were sent again, in order of time.
        retried: calls that were sent again.
        strays: replies that belong to no call.
        damaged: the first damaged frames.
        damaged_count: how many there are.
    """

    start: int
    end: int
    seen: Seen
    findings: tuple[Finding, ...]
    statistics: Statistics | None
    lanes: tuple[Lane, ...]
    lanes_left_off: int
    stays: tuple[Stay, ...]
    stays_left_off: int
    verdicts: Mapping[Verdict, int]
    chains: tuple[Exchange, ...]
    retried: int
    strays: int
    damaged: tuple[Damaged, ...]
    damaged_count: int


_Badness: TypeAlias = "tuple[int, int, int]"


class Accountant:
    """Takes in observations and what a tracker makes of them, each observation first."""

    def __init__(self, chosen: Callable[[Exchange], bool] | None = None) -> None:
        """Begin.

        Args:
            chosen: tells which calls are asked about; None for all. What is damaged is told all the same.
        """
        self._chosen = chosen
        self._diagnosis = Diagnosis(chosen, self._keep)
        self._summary = Summary()
        self._start: int | None = None
        self._end = 0
        self._lanes: dict[Conversation, _Lane] = {}
        self._lanes_left_off: set[Conversation] = set()
        self._stays: list[Stay] = []
        self._stays_left_off = 0
        self._verdicts: Counter[Verdict] = Counter()
        self._chains: list[tuple[_Badness, Exchange]] = []
        self._retried = self._strays = self._damaged_count = 0
        self._damaged: list[Damaged] = []

    def take_observation(self, seen: Observation) -> None:
        """See the next frame, or the next bytes that are none."""
        self._diagnosis.take_observation(seen)
        time = seen.time
        if self._start is None or time < self._start:
            self._start = time
        self._end = max(self._end, time)
        if seen.item.__class__ is Malformed:
            self._take_damaged(seen)

    def take(self, settled: Settled) -> None:
        """See a call that has settled, or a reply that belongs to none."""
        self._diagnosis.take(settled)
        if isinstance(settled, Stray):
            self._strays += 1
            self._look_at(settled.seen)
            return
        for seen in all_seen(settled):
            self._look_at(seen)
        if self._chosen is None or self._chosen(settled):
            self._take_call(settled)

    def finish(self, ended: int = 0) -> Account | None:
        """Tell all; None where nothing was seen.

        Args:
            ended: when the traffic ended, nanoseconds since 1970; the last frame at the earliest.
        """
        if self._start is None:
            return None
        findings = self._diagnosis.finish(ended)
        lanes = sorted(self._lanes.values(), key=lambda lane: -lane.calls)
        chains = sorted((chain for _, chain in self._chains), key=lambda chain: chain.request.time)
        return Account(
            start=self._start,
            end=self._end,
            findings=findings,
            seen=self._diagnosis.seen,
            statistics=self._summary.statistics(),
            lanes=tuple(lane.told() for lane in lanes),
            lanes_left_off=len(self._lanes_left_off),
            stays=tuple(sorted(self._stays, key=lambda stay: stay.number)),
            stays_left_off=self._stays_left_off,
            verdicts=dict(self._verdicts.most_common()),
            chains=tuple(chains),
            retried=self._retried,
            strays=self._strays,
            damaged=tuple(sorted(self._damaged, key=lambda damaged: damaged.frame)),
            damaged_count=self._damaged_count,
        )

    def _take_call(self, call: Exchange) -> None:
        self._summary.take(call)
        lane = self._lane(call.conversation)
        reply = call.reply
        plain = reply is not None and call.is_plain and not reply.item.code
        if lane is not None:
            lane.take(call, plain)
        if not plain:
            self._take_troubled(call)

    def _keep(self, stay: Stay) -> None:
        if len(self._stays) < MOST_STAYS:
            self._stays.append(stay)
        else:
            self._stays_left_off += 1

    def _lane(self, conversation: Conversation) -> _Lane | None:
        lane = self._lanes.get(conversation)
        if lane is None and len(self._lanes) < MOST_LANES:
            lane = self._lanes[conversation] = _Lane(conversation)
        elif lane is None and len(self._lanes_left_off) < MOST_COUNTED:
            self._lanes_left_off.add(conversation)
        return lane

    def _take_troubled(self, call: Exchange) -> None:
        verdict = call.verdict
        if verdict not in (Verdict.ANSWERED, Verdict.REFUSED):
            self._verdicts[verdict] += 1
        retries = call.retries
        if retries:
            self._retried += 1
            if call.weight > LARGEST_CHAIN:
                return
            badness = retries, call.latency or 0, -call.call
            (heapq.heappushpop if len(self._chains) >= MOST_CHAINS else heapq.heappush)(
                self._chains, (badness, call)
            )

    def _look_at(self, seen: FrameObservation) -> None:
        if seen.item.problems:
            self._take_damaged(seen)

    def _take_damaged(self, seen: Observation | FrameObservation) -> None:
        item = seen.item
        missing = 0 if isinstance(item, Frame) else item.missing
        lane = self._lane(seen.flow.conversation)
        if lane is not None:
            kind = MarkKind.MISSING if missing else MarkKind.DAMAGED
            lane.mark(kind, Mark(seen.time, seen.time, 1, seen.number))
        self._damaged_count += 1
        if len(self._damaged) < MOST_DAMAGED:
            about = seen.flow, len(item.raw), item.raw[:MOST_BYTES], item.problems, missing
            self._damaged.append(Damaged(seen.number, seen.time, *about))


class _Lane:
    """A lane in the making."""

    def __init__(self, conversation: Conversation) -> None:
        self.calls = 0
        self._conversation = conversation
        self._spells = Marks(MOST_SPELLS, PAUSE_NS)
        self._marks: dict[MarkKind, Marks] = {}

    def take(self, call: Exchange, plain: bool) -> None:
        """Take in a call."""
        self.calls += 1
        request = call.request
        self._spells.add(Mark(request.time, call.activity, 1, request.number))
        if not plain:
            mark = Mark(request.time, request.time, 1, request.number, call.question, call.hresult)
            for kind in _kinds(call):
                self.mark(kind, mark)

    def mark(self, kind: MarkKind, mark: Mark) -> None:
        """Set a mark."""
        marks = self._marks.get(kind)
        if marks is None:
            marks = self._marks[kind] = Marks(MOST_MARKS)
        marks.add(mark)

    def told(self) -> Lane:
        marks = {kind: self._marks[kind].all for kind in MarkKind if kind in self._marks}
        return Lane(self._conversation, self.calls, self._spells.all, marks)


def _kinds(call: Exchange) -> Sequence[MarkKind]:
    """Tell what happened to a call, the most telling thing about its way first and only that."""
    kinds = []
    verdict = call.verdict
    if verdict is Verdict.EXECUTED_TWICE:
        kinds.append(MarkKind.EXECUTED_TWICE)
    elif verdict is Verdict.REPLY_LATE:
        kinds.append(MarkKind.LATE)
    elif call.retries:
        kinds.append(MarkKind.RETRIED)
    if call.hresult is not None and is_failure(call.hresult):
        kinds.append(MarkKind.REFUSED)
    elif call.reply is None and call.given_up:
        kinds.append(MarkKind.UNANSWERED)
    return kinds
