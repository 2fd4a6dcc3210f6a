"""The differences between two captures as text and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import orjson

from bcapscope.analysis.capture_comparison import (
    CaptureComparison,
    ComparedCapture,
    Difference,
    RuleDifference,
    UnmatchedKind,
    Value,
)
from bcapscope.analysis.finding import Finding, Severity
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import align_columns, wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.findings import finding_sentence, severity_counts_text, words_for
from bcapscope.render.json_values import text_fragment
from bcapscope.render.statistics_text import call_kind_object, call_kind_text
from bcapscope.traffic.call_kind import CallKind

MAX_ROWS = 40  # rows of a text table; JSON contains all rows

_WIDTH = 96


def comparison_lines(
    comparison: CaptureComparison,
    good: ComparedCapture,
    bad: ComparedCapture,
    palette: Palette = PLAIN,
    words: MessageFormatter = ENGLISH_WORDS,
) -> Iterator[str]:
    sides = (("compare.good", good), ("compare.bad", bad))
    heads = [(words(name), printable(side.name), _size(side, words)) for name, side in sides]
    yield from align_columns(heads, "<<<")
    if not comparison.is_notable:
        yield from ("", f"{palette.good}{words('compare.nothing-notable')}{palette.reset}")
    yield from _captioned_lines(words("compare.notable"), _notable(comparison, words), palette)
    rules = _rule_lines(comparison.rules, good, bad, palette, words)
    yield from _captioned_lines(words("compare.findings"), rules, palette)
    for side, lone in ((good, comparison.only_good), (bad, comparison.only_bad)):
        caption = words("compare.only-in", capture=printable(side.name))
        rows = [(str(each.call_count), call_kind_text(each.call_kind, words)) for each in lone]
        yield from _captioned_lines(caption, _table(rows, "><", words), palette)
    others = [each for each in comparison.differences if not each.notable]
    yield from _captioned_lines(words("compare.others"), _rows(others, words), palette)


def _size(side: ComparedCapture, words: MessageFormatter) -> str:
    statistics = side.statistics
    if statistics is None:
        return words("compare.no-calls")
    seconds = f"{(statistics.end - statistics.start) / 1e9:.3f}"
    calls = Count(statistics.total.figures.calls, "call")
    found = severity_counts_text(Counter(finding.severity for finding in side.findings), words)
    if not found:
        return words("compare.size.no-findings", calls=calls, seconds=seconds)
    return words("compare.size", calls=calls, seconds=seconds, findings=found)


def _captioned_lines(caption: str, lines: Iterable[str], palette: Palette) -> Iterator[str]:
    lines = list(lines)
    if lines:
        yield from ("", f"{palette.name}{caption}{palette.reset}")
        yield from (f"  {line}" for line in lines)


def _table(rows: Sequence[tuple[str, ...]], sides: str, words: MessageFormatter) -> Iterator[str]:
    yield from align_columns(rows[:MAX_ROWS], sides)
    if len(rows) > MAX_ROWS:
        yield words("stats.more", n=len(rows) - MAX_ROWS)


def _notable(comparison: CaptureComparison, words: MessageFormatter) -> Iterator[str]:
    first, second = comparison.session_counts
    if first != second:
        yield words("compare.sessions", good=first, bad=second)
    yield from _rows([each for each in comparison.differences if each.notable], words)


def _rows(differences: Sequence[Difference], words: MessageFormatter) -> Iterator[str]:
    rows = []
    for each in differences:
        good, bad = _value(each.figure, each.good, words), _value(each.figure, each.bad, words)
        if good != bad:
            subject, figure = _subject(each.subject, words), _figure(each.figure, words)
            rows.append((subject, figure, good, "→", bad, _ratio(each)))
    return _table(rows, "<<><<<", words)


def _ratio(each: Difference) -> str:
    ratio = each.ratio
    if ratio is None:
        return ""
    return f"× {ratio:.3g}" if ratio >= 1 else f"÷ {1 / ratio:.3g}"


def _subject(subject: CallKind | int | None, words: MessageFormatter) -> str:
    if subject is None:
        return words("compare.all-calls")
    if isinstance(subject, int):
        return words("compare.session", n=subject)
    return call_kind_text(subject, words)


def _figure(figure: str, words: MessageFormatter) -> str:
    """Return the name of a figure for display, such as `latency p99` for `latency_ms.p99`."""
    name, _, statistic = figure.partition("_ms.")
    text = words(f"compare.figure.{name.replace('_', '-')}")
    return f"{text} {statistic}" if statistic else text


def _value(figure: str, value: Value, words: MessageFormatter) -> str:
    if value is None:
        return words("compare.none")
    if isinstance(value, str):
        return value
    if figure.endswith("_share"):
        return f"{value:.2%}"
    if "_ms." in figure:
        return f"{value:.3f} ms"
    if figure.endswith("_per_s"):
        return f"{value:.1f}/s"
    return f"{value:.4f}" if "_per_" in figure else f"{value:.0f}"


def _rule_lines(
    rules: Sequence[RuleDifference],
    good: ComparedCapture,
    bad: ComparedCapture,
    palette: Palette,
    words: MessageFormatter,
) -> Iterator[str]:
    for each in rules:
        shade = palette.problem if each.severity is Severity.ERROR else palette.name
        counts = f"{len(each.good)} → {len(each.bad)}"
        side, findings = (bad, each.bad) if len(each.bad) > len(each.good) else (good, each.good)
        sentence = finding_sentence(findings[0], words_for(words, side.totals))
        severity = words(f"severity.{each.severity}")
        yield f"{counts}  {shade}{severity}{palette.reset} {each.rule}"
        yield from (f"       {line}" for line in wrap_text(printable(sentence), _WIDTH))


def comparison_record(comparison: CaptureComparison, good: ComparedCapture, bad: ComparedCapture) -> bytes:
    """Return the differences between two captures as one JSON object, without a line end. Statistics have
    the same names as in `stats --json`. Shares are from 0 to 1. Times are in milliseconds."""
    return orjson.dumps(
        {
            "notable": comparison.is_notable,
            "good": _side_object(good),
            "bad": _side_object(bad),
            "differences": list(map(_difference_object, comparison.differences)),
            "only_good": [_one_sided_object(each) for each in comparison.only_good],
            "only_bad": [_one_sided_object(each) for each in comparison.only_bad],
            "findings": [_rule_object(each, good, bad) for each in comparison.rules],
        }
    )


def _side_object(side: ComparedCapture) -> dict[str, object]:
    statistics = side.statistics
    return {
        "name": text_fragment(side.name),
        "calls": 0 if statistics is None else statistics.total.figures.calls,
        "seconds": 0.0 if statistics is None else (statistics.end - statistics.start) / 1e9,
        "stays": len(side.slave_sessions),
        "findings": len(side.findings),
    }


def _difference_object(each: Difference) -> dict[str, object]:
    is_session = isinstance(each.subject, int)
    return {
        **call_kind_object(None if isinstance(each.subject, int) else each.subject),
        "stay": each.subject if is_session else None,
        "figure": each.figure,
        "good": each.good,
        "bad": each.bad,
        "ratio": each.ratio,
        "notable": each.notable,
    }


def _one_sided_object(lone: UnmatchedKind) -> dict[str, object]:
    return {**call_kind_object(lone.call_kind), "calls": lone.call_count}


def _rule_object(each: RuleDifference, good: ComparedCapture, bad: ComparedCapture) -> dict[str, object]:
    return {
        "rule": each.rule,
        "severity": each.severity,
        "good": len(each.good),
        "bad": len(each.bad),
        "good_sentences": _sentences(each.good, good),
        "bad_sentences": _sentences(each.bad, bad),
    }


def _sentences(findings: Iterable[Finding], side: ComparedCapture) -> list[orjson.Fragment]:
    words = words_for(ENGLISH_WORDS, side.totals)
    return [text_fragment(printable(finding_sentence(finding, words))) for finding in findings]
