"""What differs between two captures, such as one of a good day and one of a bad day."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.statistics import Figures, Statistics
from bcapscope.traffic.question import Question

NOTABLE_RATIO = 1.5
"""A time or a rate that grew or shrank by less is what two runs of the same program differ by anyway."""

NOTABLE_SHARE = 0.002
"""Of all calls of a kind: a difference in how many were retried, refused or left unanswered."""

FEWEST_CALLS = 8
"""Fewer calls than that say nothing about how fast such calls are."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One figure of one kind of call in both captures.

    Attributes:
        question: the kind of call; None for all calls.
        figure: what is compared, as the JSON of ``stats`` names it.
        good: its value in the first capture; None where there is none.
        bad: its value in the second.
        notable: differs by more than chance would have it.
    """

    question: Question | None
    figure: str
    good: float | None
    bad: float | None
    notable: bool


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


@dataclass(frozen=True, slots=True)
class Comparison:
    """All that differs.

    Attributes:
        differences: of figures, notable ones first, then in the order of the time that the calls take.
        only_good: kinds of call that only the first capture has.
        only_bad: kinds of call that only the second has.
        rules: of findings, most severe first.
    """

    differences: tuple[Difference, ...]
    only_good: tuple[Question, ...]
    only_bad: tuple[Question, ...]
    rules: tuple[RuleDifference, ...]


def compare(
    good: Statistics, bad: Statistics, found_good: Iterable[Finding], found_bad: Iterable[Finding]
) -> Comparison:
    """Compare the figures and findings of two captures, all clients of each together."""
    kinds_good, kinds_bad = _by_question(good), _by_question(bad)
    pairs: list[tuple[Question | None, Figures, Figures]] = [(None, good.total.figures, bad.total.figures)]
    pairs += [(kind, kinds_good[kind], figures) for kind, figures in kinds_bad.items() if kind in kinds_good]
    differences = [each for question, one, two in pairs for each in _differences(question, one, two)]
    return Comparison(
        tuple(sorted(differences, key=lambda each: not each.notable)),
        tuple(kind for kind in kinds_good if kind not in kinds_bad),
        tuple(kind for kind in kinds_bad if kind not in kinds_good),
        _rules(tuple(found_good), tuple(found_bad)),
    )


def _by_question(statistics: Statistics) -> dict[Question, Figures]:
    return {row.question: row.figures for row in statistics.kinds if row.question is not None}


def _differences(question: Question | None, good: Figures, bad: Figures) -> Iterable[Difference]:
    enough = min(good.calls, bad.calls) >= FEWEST_CALLS
    for name, read, judge in _FIGURES:
        one, two = read(good), read(bad)
        if one == two:
            continue
        yield Difference(question, name, one, two, judge(one, two, enough))


def _far_apart(good: float | None, bad: float | None, enough: bool) -> bool:
    if good is None or bad is None or not enough:
        return False
    return max(good, bad) > NOTABLE_RATIO * min(good, bad)


def _other_share(good: float | None, bad: float | None, enough: bool) -> bool:
    return abs((good or 0.0) - (bad or 0.0)) > NOTABLE_SHARE


def _never(good: float | None, bad: float | None, enough: bool) -> bool:
    return False


def _part(read: Callable[[Figures], int]) -> Callable[[Figures], float]:
    return lambda figures: read(figures) / figures.calls if figures.calls else 0.0


def _time(percentile: str) -> Callable[[Figures], float | None]:
    return lambda figures: None if figures.latency is None else float(getattr(figures.latency, percentile))


_FIGURES: tuple[
    tuple[str, Callable[[Figures], float | None], Callable[[float | None, float | None, bool], bool]], ...
] = (
    ("calls", lambda figures: figures.calls, _never),
    ("calls_per_s", lambda figures: figures.rate, _far_apart),
    ("line_time_share", lambda figures: figures.share, _far_apart),
    ("latency_ms.p50", _time("p50"), _far_apart),
    ("latency_ms.p99", _time("p99"), _far_apart),
    ("latency_ms.max", _time("most"), _far_apart),
    ("retried_share", _part(lambda figures: figures.retried), _other_share),
    ("late_share", _part(lambda figures: figures.late), _other_share),
    ("refused_share", _part(lambda figures: figures.refused), _other_share),
    ("unanswered_share", _part(lambda figures: figures.unanswered), _other_share),
)


def _rules(good: tuple[Finding, ...], bad: tuple[Finding, ...]) -> tuple[RuleDifference, ...]:
    counts_good, counts_bad = Counter(f.rule for f in good), Counter(f.rule for f in bad)
    severities = {finding.rule: finding.severity for finding in (*good, *bad)}
    found = [
        RuleDifference(
            rule,
            severity,
            tuple(finding for finding in good if finding.rule == rule),
            tuple(finding for finding in bad if finding.rule == rule),
        )
        for rule, severity in severities.items()
        if counts_good[rule] != counts_bad[rule]
    ]
    order = list(Severity)
    return tuple(sorted(found, key=lambda each: order.index(each.severity)))
