"""Differences between two captures, for people and for programs."""

from __future__ import annotations

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
from bcapscope.analysis.statistics.call_statistics import OTHER_KINDS
from bcapscope.messages import ENGLISH_WORDS
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.text_format import counted
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import align_columns, wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.finding_text import finding_sentence, words_for
from bcapscope.render.frame_record import json_text
from bcapscope.render.statistics_text import call_kind_text
from bcapscope.traffic.call_kind import CallKind

MAX_ROWS = 40
"""Rows of a table for people; JSON has all."""

_WIDTH = 96
_FIGURE_NAMES = {
    "calls": "calls",
    "calls_per_s": "calls",
    "line_time_share": "line time",
    "retried_share": "retried",
    "late_replies_per_call": "late replies per call",
    "refused_share": "refused",
    "unanswered_share": "unanswered",
    "not_followed_share": "not followed to the end",
    "exit": "ended by",
    "set_points": "set points",
    "late_for_timeout_share": "late for the time-out",
    "gaps": "gaps longer than the buffer lasts",
    "predicted_underflows": "underflows by the model",
    "reported_underflows": "underflows reported",
    "reported_overflows": "overflows reported",
    "retries_per_set_point": "retries per set point",
}


def comparison_lines(
    comparison: CaptureComparison, good: ComparedCapture, bad: ComparedCapture, palette: Palette = PLAIN
) -> Iterator[str]:
    """Write what differs, notable things first.

    Args:
        comparison: of the two.
        good: the first capture.
        bad: the second.
        palette: colours.
    """
    heads = [(name, printable(side.name), _size(side)) for name, side in (("good", good), ("bad", bad))]
    yield from align_columns(heads, "<<<")
    if not comparison.is_notable:
        yield from ("", f"{palette.good}nothing notable differs{palette.reset}")
    yield from _captioned_lines("notable", _notable(comparison), palette)
    yield from _captioned_lines("findings", _rule_lines(comparison.rules, good, bad, palette), palette)
    yield from _captioned_lines(
        f"asked only in {printable(good.name)}", _one_sided_rows(comparison.only_good), palette
    )
    yield from _captioned_lines(
        f"asked only in {printable(bad.name)}", _one_sided_rows(comparison.only_bad), palette
    )
    others = [each for each in comparison.differences if not each.notable]
    yield from _captioned_lines("other differences", _rows(others), palette)


def _size(side: ComparedCapture) -> str:
    statistics = side.statistics
    if statistics is None:
        return "no calls"
    seconds = (statistics.end - statistics.start) / 1e9
    counts = {severity: 0 for severity in Severity}
    for finding in side.findings:
        counts[finding.severity] += 1
    found = [counted(count, severity.value) for severity, count in counts.items() if count]
    return f"{counted(statistics.total.figures.calls, 'call')} in {seconds:.3f} s; " + (
        ", ".join(found) or "nothing found"
    )


def _captioned_lines(caption: str, lines: Iterable[str], palette: Palette) -> Iterator[str]:
    """Write a caption and what stands under it; nothing where nothing would."""
    lines = list(lines)
    if lines:
        yield from ("", f"{palette.name}{caption}{palette.reset}")
        yield from (f"  {line}" for line in lines)


def _table(rows: Sequence[tuple[str, ...]], sides: str) -> Iterator[str]:
    yield from align_columns(rows[:MAX_ROWS], sides)
    if len(rows) > MAX_ROWS:
        yield f"… and {len(rows) - MAX_ROWS} more"


def _notable(comparison: CaptureComparison) -> Iterator[str]:
    first, second = comparison.session_counts
    if first != second:
        yield f"stays in slave mode: {first} → {second}"
    yield from _rows([each for each in comparison.differences if each.notable])


def _rows(differences: Sequence[Difference]) -> Iterator[str]:
    rows = []
    for each in differences:
        good, bad = _value(each.figure, each.good), _value(each.figure, each.bad)
        if good != bad:
            rows.append((_subject(each.subject), _figure(each.figure), good, "→", bad, _ratio(each)))
    return _table(rows, "<<><<<")


def _ratio(each: Difference) -> str:
    ratio = each.ratio
    if ratio is None:
        return ""
    return f"× {ratio:.3g}" if ratio >= 1 else f"÷ {1 / ratio:.3g}"


def _subject(subject: CallKind | int | None) -> str:
    if subject is None:
        return "all calls"
    return f"slave mode, stay {subject}" if isinstance(subject, int) else call_kind_text(subject)


def _figure(figure: str) -> str:
    """Name a figure for people: `latency p99` for `latency_ms.p99`."""
    return _FIGURE_NAMES.get(figure) or figure.replace("_ms.", " ")


def _value(figure: str, value: Value) -> str:
    if value is None:
        return "none"
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
    rules: Sequence[RuleDifference], good: ComparedCapture, bad: ComparedCapture, palette: Palette
) -> Iterator[str]:
    for each in rules:
        shade = palette.problem if each.severity is Severity.ERROR else palette.name
        counts = f"{len(each.good)} → {len(each.bad)}"
        side, findings = (bad, each.bad) if len(each.bad) > len(each.good) else (good, each.good)
        sentence = finding_sentence(findings[0], words_for(ENGLISH_WORDS, side.totals))
        yield f"{counts}  {shade}{each.severity}{palette.reset} {each.rule}"
        yield from (f"       {line}" for line in wrap_text(printable(sentence), _WIDTH))


def _one_sided_rows(lone: Sequence[UnmatchedKind]) -> Iterator[str]:
    return _table([(str(each.call_count), call_kind_text(each.call_kind)) for each in lone], "><")


def comparison_record(comparison: CaptureComparison, good: ComparedCapture, bad: ComparedCapture) -> bytes:
    """Write what differs as one JSON object, without a line end.

    Figures are named as in the JSON of ``stats`` where that has them; shares are of 1, times in milliseconds.
    """
    form = (
        b'{"notable":%b,"good":%b,"bad":%b,"differences":[%b],"only_good":[%b],"only_bad":[%b],'
        b'"findings":[%b]}'
    )
    return form % (
        orjson.dumps(comparison.is_notable),
        _side_record(good),
        _side_record(bad),
        b",".join(map(_difference_record, comparison.differences)),
        b",".join(map(_one_sided_record, comparison.only_good)),
        b",".join(map(_one_sided_record, comparison.only_bad)),
        b",".join(_rule_record(each, good, bad) for each in comparison.rules),
    )


def _side_record(side: ComparedCapture) -> bytes:
    statistics = side.statistics
    calls = 0 if statistics is None else statistics.total.figures.calls
    seconds = 0.0 if statistics is None else (statistics.end - statistics.start) / 1e9
    counts = (calls, orjson.dumps(seconds), len(side.slave_sessions), len(side.findings))
    return b'{"name":%b,"calls":%d,"seconds":%b,"stays":%d,"findings":%d}' % (json_text(side.name), *counts)


def _difference_record(each: Difference) -> bytes:
    subject = each.subject
    stay = subject if isinstance(subject, int) else None
    question = None if isinstance(subject, int) else subject
    values = {"good": each.good, "bad": each.bad, "ratio": each.ratio, "notable": each.notable}
    figure = {"stay": stay, "figure": each.figure, **values}
    return b"{%b,%b" % (_call_kind_members(question), orjson.dumps(figure)[1:])


def _call_kind_members(call_kind: CallKind | None) -> bytes:
    if call_kind is None:
        return b'"function":null,"command":null'
    name = "others" if call_kind is OTHER_KINDS else function_name(call_kind.function_id)
    return b'"function":%b,"command":%b' % (json_text(name), json_text(call_kind.command))


def _one_sided_record(lone: UnmatchedKind) -> bytes:
    return b'{%b,"calls":%d}' % (_call_kind_members(lone.call_kind), lone.call_count)


def _rule_record(each: RuleDifference, good: ComparedCapture, bad: ComparedCapture) -> bytes:
    head = (json_text(each.rule), json_text(each.severity.value), len(each.good), len(each.bad))
    return b'{"rule":%b,"severity":%b,"good":%d,"bad":%d,"good_sentences":[%b],"bad_sentences":[%b]}' % (
        *head,
        _sentences(each.good, good),
        _sentences(each.bad, bad),
    )


def _sentences(findings: Iterable[Finding], side: ComparedCapture) -> bytes:
    words = words_for(ENGLISH_WORDS, side.totals)
    return b",".join(json_text(printable(finding_sentence(finding, words))) for finding in findings)
