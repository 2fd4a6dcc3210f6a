"""Compare two captures, such as a capture from a good day with a capture from a bad day."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.finding import NO_TRAFFIC, Finding, Severity, TrafficTotals
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS, CallFigures, Statistics
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.traffic.call_kind import CallKind

MAX_SESSIONS = 64
"""Maximum number of slave-mode sessions that are compared: the first ones of each capture."""

FEWEST_SAMPLES = 8
"""A difference in speed is notable only if each capture has at least this many calls or cycles."""

NOTABLE_RATIO = 1.5
"""Smallest notable ratio of times or rates. Smaller ratios are normal between two captures of the same
program.
"""

NOTABLE_CYCLE = 1.1
"""Smallest notable ratio of median cycle times. It is smaller than `NOTABLE_RATIO`, because a client should
keep its cycle time constant.
"""

NOTABLE_MS = 0.2
"""Smallest notable difference of latencies, ms: a tenth of the shortest timeout that DENSO recommends to
clients, 2 ms (DENSO Wave 2009).
"""

NOTABLE_SHARE = 0.002
"""Smallest notable difference in the share of calls that were retried, refused or left unanswered."""

CHANCE_SIGMAS = 3.0
"""Smallest notable difference, in standard deviations, between two counts of random events such as losses."""

Value: TypeAlias = "float | str | None"


@dataclass(frozen=True, slots=True)
class ComparedCapture:
    """Data of one capture, with at most `MAX_SESSIONS` slave-mode sessions in the order of their starts."""

    name: str
    statistics: Statistics | None
    slave_sessions: tuple[SlaveSession, ...]
    findings: tuple[Finding, ...]
    totals: TrafficTotals = NO_TRAFFIC


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure that differs between two captures.

    Attributes:
        subject: Kind of call or number of the slave-mode session; None for all calls.
        figure: Name of the figure, such as `latency_ms.p50`, as in the JSON of ``stats``.
        good: Value in the first capture; None if the capture has no such value.
        bad: Value in the second capture; None if the capture has no such value.
        notable: Whether the difference is too large for two captures of the same faultless program.
    """

    subject: CallKind | int | None
    figure: str
    good: Value
    bad: Value
    notable: bool

    @property
    def ratio(self) -> float | None:
        """`bad` divided by `good`; None unless both are positive numbers."""
        good, bad = self.good, self.bad
        return bad / good if isinstance(good, float) and isinstance(bad, float) and good > 0 < bad else None


@dataclass(frozen=True, slots=True)
class RuleDifference:
    """A rule with a different number of findings in the two captures."""

    rule: str
    severity: Severity
    good: tuple[Finding, ...]
    bad: tuple[Finding, ...]


class UnmatchedKind(NamedTuple):
    call_kind: CallKind
    call_count: int


@dataclass(frozen=True, slots=True)
class CaptureComparison:
    """All differences between two captures.

    Attributes:
        differences: Figures that differ: first the notable figures, then the others. In both parts, the order
            is: slave-mode sessions, all calls together, kinds of call (longest total time first).
        session_counts: Number of slave-mode sessions in each capture.
        rules: Rules whose number of findings differs. Rules with more findings in the second capture come
            first. Otherwise, the rules are in the order of ``diagnose``.
    """

    differences: tuple[Difference, ...]
    only_good: tuple[UnmatchedKind, ...]
    only_bad: tuple[UnmatchedKind, ...]
    session_counts: tuple[int, int]
    rules: tuple[RuleDifference, ...]

    @property
    def is_notable(self) -> bool:
        """Whether the captures differ notably. Kinds of call that occur in only one capture do not count."""
        sessions_differ = self.session_counts[0] != self.session_counts[1]
        rules = any(each.severity is not Severity.NOTE for each in self.rules)
        return sessions_differ or rules or any(each.notable for each in self.differences)


def compare(good: ComparedCapture, bad: ComparedCapture) -> CaptureComparison:
    """Compare two captures: figures, findings, and slave-mode sessions (first with first, and so on)."""
    kinds_good, kinds_bad = _by_kind(good.statistics), _by_kind(bad.statistics)
    differences = list(_session_differences(good, bad))
    if good.statistics is not None and bad.statistics is not None and len({*kinds_good, *kinds_bad}) > 1:
        differences += _call_differences(None, good.statistics.total.figures, bad.statistics.total.figures)
    for kind, figures in kinds_bad.items():
        if kind in kinds_good:
            differences += _call_differences(kind, kinds_good[kind], figures)
    return CaptureComparison(
        tuple(sorted(differences, key=lambda each: not each.notable)),
        _unmatched_kinds(kinds_good, kinds_bad),
        _unmatched_kinds(kinds_bad, kinds_good),
        (len(good.slave_sessions), len(bad.slave_sessions)),
        tuple(_rule_differences(good.findings, bad.findings)),
    )


def _by_kind(statistics: Statistics | None) -> dict[CallKind, CallFigures]:
    rows = () if statistics is None else statistics.kinds
    return {row.call_kind or OTHER_KINDS: row.figures for row in rows}


def _unmatched_kinds(
    mine: dict[CallKind, CallFigures], other: dict[CallKind, CallFigures]
) -> tuple[UnmatchedKind, ...]:
    return tuple(UnmatchedKind(kind, mine[kind].calls) for kind in mine if kind not in other)


# Function that decides whether two values of a figure differ notably. The last argument contains two numbers:
# how many calls or set points the figure describes in each capture.
_JudgeFigure: TypeAlias = Callable[[Value, Value, "tuple[int, int]"], bool]


def _judge_ratio(ratio: float, least: float = 0.0) -> _JudgeFigure:
    """Test whether two values differ by more than the factor `ratio` and by more than `least`."""

    def judge(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
        if not (isinstance(good, float) and isinstance(bad, float)) or min(counts) < FEWEST_SAMPLES:
            return False
        low, high = sorted((good, bad))
        return high > ratio * low and high - low > least

    return judge


def _judge_share(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    return isinstance(good, float) and isinstance(bad, float) and abs(good - bad) > NOTABLE_SHARE


def _judge_chance_share(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    """Test whether two shares of random events, such as losses, differ by more than chance explains."""
    if not (isinstance(good, float) and isinstance(bad, float)) or not _judge_share(good, bad, counts):
        return False
    one, two = counts
    both = (good * one + bad * two) / (one + two)
    return abs(good - bad) > CHANCE_SIGMAS * math.sqrt(both * (1 / one + 1 / two))


def _judge_word(good: Value, bad: Value, counts: tuple[int, int]) -> bool:
    unseen = (None, ExitReason.CAPTURE_ENDED.value)
    return good not in unseen and bad not in unseen


def _always_notable(*_: object) -> bool:
    return True


def _never_notable(*_: object) -> bool:
    return False


def _call_differences(kind: CallKind | None, good: CallFigures, bad: CallFigures) -> Iterator[Difference]:
    few = min(good.calls, bad.calls) < FEWEST_SAMPLES
    for figure, read, judge in _CALL_FIGURES:
        if figure in (_SPEEDS if kind is None else _PACES if few else ()):
            continue
        one, two = read(good), read(bad)
        if one != two:
            yield Difference(kind, figure, one, two, judge(one, two, (good.calls, bad.calls)))


def _per_call(read: Callable[[CallFigures], int]) -> Callable[[CallFigures], Value]:
    return lambda figures: read(figures) / figures.calls


def _latency_figure(percentile: str) -> Callable[[CallFigures], Value]:
    return lambda figures: None if figures.latency is None else float(getattr(figures.latency, percentile))


_CALL_FIGURES: tuple[tuple[str, Callable[[CallFigures], Value], _JudgeFigure], ...] = (
    ("calls", lambda figures: float(figures.calls), _never_notable),
    ("calls_per_s", lambda figures: figures.calls_per_second, _judge_ratio(NOTABLE_RATIO)),
    # `line_time_share` follows from `calls_per_s` and the latency, which are compared separately.
    ("line_time_share", lambda figures: figures.line_time_share, _never_notable),
    ("latency_ms.p50", _latency_figure("p50"), _judge_ratio(NOTABLE_RATIO, NOTABLE_MS)),
    ("latency_ms.p99", _latency_figure("p99"), _judge_ratio(NOTABLE_RATIO, NOTABLE_MS)),
    ("latency_ms.max", _latency_figure("most"), _judge_ratio(2 * NOTABLE_RATIO, NOTABLE_MS)),
    ("retried_share", _per_call(lambda figures: figures.retried_calls), _judge_chance_share),
    ("late_replies_per_call", _per_call(lambda figures: figures.late_replies), _judge_chance_share),
    ("refused_share", _per_call(lambda figures: figures.refused), _judge_share),
    ("unanswered_share", _per_call(lambda figures: figures.unanswered), _judge_share),
    # `not_followed_share` is never notable, because this share depends on a memory limit of bcapscope.
    ("not_followed_share", _per_call(lambda figures: figures.not_followed), _never_notable),
)

_SPEEDS = ("latency_ms.p50", "latency_ms.p99", "latency_ms.max")
"""Figures that are compared only for single kinds of call, because a mix of kinds changes these figures."""

_PACES = ("calls_per_s", "line_time_share")
"""If a capture has few calls, these figures depend on the length of the capture."""


def _session_differences(good: ComparedCapture, bad: ComparedCapture) -> Iterator[Difference]:
    for number, (first, second) in enumerate(zip(good.slave_sessions, bad.slave_sessions, strict=False), 1):
        counts = (first.counts.sent, second.counts.sent)
        for figure, read, judge in _SESSION_FIGURES:
            one, two = read(first), read(second)
            if one != two:
                yield Difference(number, figure, one, two, judge(one, two, counts))


def _mode_text(session: SlaveSession) -> Value:
    return None if session.mode.value is None else f"0x{session.mode.value:03X}"


def _exit_text(session: SlaveSession) -> Value:
    code = session.exit.hresult
    return session.exit.reason.value + (f" ({hresult_name(code)})" if code else "")


def _cycle_figure(percentile: str) -> Callable[[SlaveSession], Value]:
    return lambda session: (
        None if session.timing.cycle is None else float(getattr(session.timing.cycle, percentile))
    )


def _per_set_point(read: Callable[[SlaveSession], int]) -> Callable[[SlaveSession], Value]:
    return lambda session: read(session) / session.counts.sent if session.counts.sent else None


def _late_count(session: SlaveSession) -> int:
    return sum(deadline.late for deadline in session.timing.deadlines if deadline.applies)


_SESSION_FIGURES: tuple[tuple[str, Callable[[SlaveSession], Value], _JudgeFigure], ...] = (
    ("mode", _mode_text, _judge_word),
    ("exit", _exit_text, _judge_word),
    ("set_points", lambda session: float(session.counts.sent), _never_notable),
    ("cycle_ms.p50", _cycle_figure("p50"), _judge_ratio(NOTABLE_CYCLE)),
    ("cycle_ms.p99", _cycle_figure("p99"), _judge_ratio(NOTABLE_RATIO)),
    ("cycle_ms.max", _cycle_figure("most"), _judge_ratio(NOTABLE_RATIO)),
    ("late_for_timeout_share", _per_set_point(_late_count), _judge_chance_share),
    ("gaps", lambda session: float(session.timing.gaps), _judge_ratio(NOTABLE_RATIO)),
    ("predicted_underflows", lambda session: float(session.buffer.underflows), _judge_ratio(NOTABLE_RATIO)),
    ("reported_underflows", lambda session: float(len(session.buffer.reported_underflows)), _always_notable),
    ("reported_overflows", lambda session: float(len(session.buffer.reported_overflows)), _always_notable),
    ("retries_per_set_point", _per_set_point(lambda session: session.counts.retries), _judge_chance_share),
    ("unanswered_share", _per_set_point(lambda session: session.counts.unanswered), _judge_share),
    ("not_followed_share", _per_set_point(lambda session: session.counts.not_followed), _never_notable),
)


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
