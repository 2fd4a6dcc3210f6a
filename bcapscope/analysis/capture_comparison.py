"""What differs between two captures, such as one of a good day and one of a bad day."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, CallFigures, Statistics
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.traffic.call_kind import CallKind

MAX_SESSIONS = 64
"""Stays in slave mode of one capture that are compared, the first ones."""

FEWEST_SAMPLES = 8
"""Fewer calls or cycles than that say nothing about how fast such calls are."""

NOTABLE_RATIO = 1.5
"""A time or a rate that grew or shrank by less is what two runs of the same program differ by anyway."""

NOTABLE_CYCLE = 1.1
"""The same for the typical cycle of set points, which a client is meant to keep."""

NOTABLE_MS = 0.2
"""A difference in latency below that hurts nobody: the shortest time-out in use is 2 ms (DENSO Wave 2009)."""

NOTABLE_SHARE = 0.002
"""Of all calls of a kind: a difference in how many were retried, refused or left unanswered."""

CHANCE_SIGMAS = 3.0
"""Standard deviations that must lie between two counts of what happens by chance, as losses do."""

Value: TypeAlias = "float | str | None"


@dataclass(frozen=True, slots=True)
class ComparedCapture:
    """What is compared of a capture.

    Attributes:
        name: of the capture, for people.
        statistics: of its calls; None where it has none.
        slave_sessions: its stays in slave mode, in the order of their beginnings, `MAX_SESSIONS` at most.
        findings: of its diagnosis.
    """

    name: str
    statistics: Statistics | None
    slave_sessions: tuple[SlaveSession, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure of one kind of call, of one stay in slave mode or of all calls, in both captures.

    Attributes:
        subject: the kind of call, or the number of the stay in either capture; None for all calls.
        figure: what is compared, as the JSON of ``stats`` names it where that has it.
        good: its value in the first capture, a number or a word; None where there is none.
        bad: its value in the second.
        notable: differs by more than two good runs would.
    """

    subject: CallKind | int | None
    figure: str
    good: Value
    bad: Value
    notable: bool

    @property
    def ratio(self) -> float | None:
        """How many times the value in the first capture the other one is; None where that says nothing."""
        good, bad = self.good, self.bad
        return bad / good if isinstance(good, float) and isinstance(bad, float) and good > 0 < bad else None


@dataclass(frozen=True, slots=True)
class RuleDifference:
    """A rule that found something in one capture and not, or not as often, in the other.

    Attributes:
        rule: its id.
        severity: of its findings.
        good: the findings in the first capture.
        bad: those in the second.
    """

    rule: str
    severity: Severity
    good: tuple[Finding, ...]
    bad: tuple[Finding, ...]


class UnmatchedKind(NamedTuple):
    """A kind of call that only one capture has.

    Attributes:
        call_kind: the kind.
        call_count: how many there are.
    """

    call_kind: CallKind
    call_count: int


@dataclass(frozen=True, slots=True)
class CaptureComparison:
    """All that differs.

    Attributes:
        differences: of figures, notable ones first; in either part those of stays in slave mode, then of all
            calls, then of each kind of call in the order of the time that it takes.
        only_good: kinds of call that only the first capture has.
        only_bad: kinds of call that only the second has.
        session_counts: in slave mode, in the first and in the second capture.
        rules: of findings; first what only the second capture has or has more of, in the order in which it
            was diagnosed, the first cause first.
    """

    differences: tuple[Difference, ...]
    only_good: tuple[UnmatchedKind, ...]
    only_bad: tuple[UnmatchedKind, ...]
    session_counts: tuple[int, int]
    rules: tuple[RuleDifference, ...]

    @property
    def is_notable(self) -> bool:
        """Whether anything differs by more than two good runs would, kinds of calls left aside."""
        stays = self.session_counts[0] != self.session_counts[1]
        rules = any(each.severity is not Severity.NOTE for each in self.rules)
        return stays or rules or any(each.notable for each in self.differences)


def compare(good: ComparedCapture, bad: ComparedCapture) -> CaptureComparison:
    """Compare the figures and findings of two captures, all clients of each together.

    The first stay in slave mode of one is compared with the first of the other, and so on.
    """
    kinds_good, kinds_bad = _by_question(good.statistics), _by_question(bad.statistics)
    differences = list(_session_differences(good, bad))
    if good.statistics is not None and bad.statistics is not None and len({*kinds_good, *kinds_bad}) > 1:
        differences += _call_differences(None, good.statistics.total.figures, bad.statistics.total.figures)
    for question, figures in kinds_bad.items():
        if question in kinds_good:
            differences += _call_differences(question, kinds_good[question], figures)
    return CaptureComparison(
        tuple(sorted(differences, key=lambda each: not each.notable)),
        tuple(_unmatched_kinds(kinds_good, kinds_bad)),
        tuple(_unmatched_kinds(kinds_bad, kinds_good)),
        (len(good.slave_sessions), len(bad.slave_sessions)),
        tuple(_rule_differences(good.findings, bad.findings)),
    )


def _by_question(statistics: Statistics | None) -> dict[CallKind, CallFigures]:
    rows = () if statistics is None else statistics.kinds
    return {row.call_kind or OTHER_KINDS: row.figures for row in rows}


def _unmatched_kinds(
    mine: dict[CallKind, CallFigures], other: dict[CallKind, CallFigures]
) -> Iterator[UnmatchedKind]:
    for question, figures in mine.items():
        if question not in other:
            yield UnmatchedKind(question, figures.calls)


# judgement: each takes both values, and how many calls or cycles each of them rests on

_JudgeFigure: TypeAlias = Callable[[Value, Value, "tuple[int, int]"], bool]


def _judge_ratio(ratio: float, least: float = 0.0) -> _JudgeFigure:
    """Judge times and rates: notable if one is so many times the other, and by at least so much."""

    def judge(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
        if not (isinstance(good, float) and isinstance(bad, float)) or min(counts) < FEWEST_SAMPLES:
            return False
        low, high = sorted((good, bad))
        return high > ratio * low and high - low > least

    return judge


def _judge_share(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    """Judge shares of what has a reason whenever it happens, such as refusals."""
    return isinstance(good, float) and isinstance(bad, float) and abs(good - bad) > NOTABLE_SHARE


def _judge_chance_share(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    """Judge how often something happens by chance, such as losses, whose counts Poisson spreads."""
    if not (isinstance(good, float) and isinstance(bad, float)) or not _judge_share(good, bad, counts):
        return False
    one, two = counts
    both = (good * one + bad * two) / (one + two)
    return abs(good - bad) > CHANCE_SIGMAS * math.sqrt(both * (1 / one + 1 / two))


def _judge_word(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    """Judge words: that nothing was seen of one is no difference."""
    unseen = (None, ExitReason.CAPTURE_ENDED.value)
    return good not in unseen and bad not in unseen


def _always_notable(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    return True


def _never_notable(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    return False


# calls


def _call_differences(question: CallKind | None, good: CallFigures, bad: CallFigures) -> Iterator[Difference]:
    few = min(good.calls, bad.calls) < FEWEST_SAMPLES
    for figure, read, judge in _CALL_FIGURES:
        if figure in (_SPEEDS if question is None else _PACES if few else ()):
            continue
        one, two = read(good), read(bad)
        if one != two:
            yield Difference(question, figure, one, two, judge(one, two, (good.calls, bad.calls)))


def _per_call(read: Callable[[CallFigures], int]) -> Callable[[CallFigures], Value]:
    return lambda figures: read(figures) / figures.calls


def _latency_figure(percentile: str) -> Callable[[CallFigures], Value]:
    return lambda figures: None if figures.latency is None else float(getattr(figures.latency, percentile))


_CALL_FIGURES: tuple[tuple[str, Callable[[CallFigures], Value], _JudgeFigure], ...] = (
    ("calls", lambda figures: float(figures.calls), _never_notable),
    ("calls_per_s", lambda figures: figures.calls_per_second, _judge_ratio(NOTABLE_RATIO)),
    (
        "line_time_share",
        lambda figures: figures.line_time_share,
        _never_notable,
    ),  # follows from the two beside it
    ("latency_ms.p50", _latency_figure("p50"), _judge_ratio(NOTABLE_RATIO, NOTABLE_MS)),
    ("latency_ms.p99", _latency_figure("p99"), _judge_ratio(NOTABLE_RATIO, NOTABLE_MS)),
    ("latency_ms.max", _latency_figure("most"), _judge_ratio(2 * NOTABLE_RATIO, NOTABLE_MS)),
    ("retried_share", _per_call(lambda figures: figures.retried_calls), _judge_chance_share),
    ("late_replies_per_call", _per_call(lambda figures: figures.late_replies), _judge_chance_share),
    ("refused_share", _per_call(lambda figures: figures.refused), _judge_share),
    ("unanswered_share", _per_call(lambda figures: figures.unanswered), _judge_share),
    (
        "not_followed_share",
        _per_call(lambda figures: figures.not_followed),
        _never_notable,
    ),  # that is our own doing
)

_SPEEDS = ("latency_ms.p50", "latency_ms.p99", "latency_ms.max")
"""Of different kinds of call together these tell which were asked, not how fast they are."""

_PACES = ("calls_per_s", "line_time_share")
"""Of a few calls these tell how long the capture is."""


# stays in slave mode


def _session_differences(good: ComparedCapture, bad: ComparedCapture) -> Iterator[Difference]:
    for number, (first, second) in enumerate(zip_longest(good.slave_sessions, bad.slave_sessions), 1):
        if first is None or second is None:
            return
        counts = (first.counts.sent, second.counts.sent)
        for figure, read, judge in _SESSION_FIGURES:
            one, two = read(first), read(second)
            if one != two:
                yield Difference(number, figure, one, two, judge(one, two, counts))


def _mode_text(stay: SlaveSession) -> Value:
    return None if stay.mode.value is None else f"0x{stay.mode.value:03X}"


def _exit_text(stay: SlaveSession) -> Value:
    code = stay.exit.hresult
    return stay.exit.reason.value + (f" ({hresult_name(code)})" if code else "")


def _cycle_figure(percentile: str) -> Callable[[SlaveSession], Value]:
    return lambda stay: None if stay.timing.cycle is None else float(getattr(stay.timing.cycle, percentile))


def _per_set_point(read: Callable[[SlaveSession], int]) -> Callable[[SlaveSession], Value]:
    return lambda stay: read(stay) / stay.counts.sent if stay.counts.sent else None


def _late_count(stay: SlaveSession) -> int:
    return sum(deadline.late for deadline in stay.timing.deadlines if deadline.applies)


_SESSION_FIGURES: tuple[tuple[str, Callable[[SlaveSession], Value], _JudgeFigure], ...] = (
    ("mode", _mode_text, _judge_word),
    ("exit", _exit_text, _judge_word),
    ("set_points", lambda stay: float(stay.counts.sent), _never_notable),
    ("cycle_ms.p50", _cycle_figure("p50"), _judge_ratio(NOTABLE_CYCLE)),
    ("cycle_ms.p99", _cycle_figure("p99"), _judge_ratio(NOTABLE_RATIO)),
    ("cycle_ms.max", _cycle_figure("most"), _judge_ratio(NOTABLE_RATIO)),
    ("late_for_timeout_share", _per_set_point(_late_count), _judge_chance_share),
    ("gaps", lambda stay: float(stay.timing.gaps), _judge_ratio(NOTABLE_RATIO)),
    ("predicted_underflows", lambda stay: float(stay.buffer.underflows), _judge_ratio(NOTABLE_RATIO)),
    ("reported_underflows", lambda stay: float(len(stay.buffer.reported_underflows)), _always_notable),
    ("reported_overflows", lambda stay: float(len(stay.buffer.reported_overflows)), _always_notable),
    ("retries_per_set_point", _per_set_point(lambda stay: stay.counts.retries), _judge_chance_share),
    ("unanswered_share", _per_set_point(lambda stay: stay.counts.unanswered), _judge_share),
    ("not_followed_share", _per_set_point(lambda stay: stay.counts.not_followed), _never_notable),
)


# findings


def _rule_differences(good: Iterable[Finding], bad: Iterable[Finding]) -> list[RuleDifference]:
    by_rule: dict[str, tuple[list[Finding], list[Finding]]] = {}
    for finding in bad:
        by_rule.setdefault(finding.rule, ([], []))[1].append(finding)
    for finding in good:
        by_rule.setdefault(finding.rule, ([], []))[0].append(finding)
    found = [
        RuleDifference(rule, (first or second)[0].severity, tuple(first), tuple(second))
        for rule, (first, second) in by_rule.items()
        if len(first) != len(second)
    ]
    return sorted(found, key=lambda each: len(each.bad) < len(each.good))
