"""Sentences about findings, in the reader's language."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from bcapscope.analysis.finding import Consequence, Finding, Repetition, Severity, TrafficTotals
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import Count, Duration, Moment, Times
from bcapscope.render.color_palette import PLAIN, Palette

_DEEPEST = 4


def words_for(words: MessageFormatter, totals: TrafficTotals) -> MessageFormatter:
    """Return a formatter that writes times relative to the start of the traffic. `totals` gives this
    start.
    """
    return words.for_report(totals.began, totals.has_only_client)


def finding_sentence(finding: Finding, words: MessageFormatter) -> str:
    """Return the text of a finding: what happened, how often, and what followed.

    The text may contain unescaped strings from the wire.
    """
    return words.sentences(_sentences(finding, words))


def finding_depths(findings: Sequence[Finding]) -> list[int]:
    """Return the indentation depth of each finding: 0 for a finding without a cause, otherwise the depth of
    the cause plus one, at most 4.
    """
    depths: list[int] = []
    for finding in findings:
        cause = finding.consequence_of
        depths.append(0 if cause is None else min(depths[cause - 1] + 1, _DEEPEST))
    return depths


def _sentences(finding: Finding, words: MessageFormatter) -> Iterator[str]:
    yield words.text(finding.fact)
    if finding.repetition is not None:
        yield words.text(_repetition_message(finding.repetition))
    for each in finding.consequences:
        yield _consequence_sentence(each, words)
    if finding.explains_rest:
        yield words("finding.explains-rest")
    elif finding.followed_by is not None:
        first, last = finding.followed_by
        if first == last:
            yield words("finding.followed-by-one", number=first)
        else:
            yield words(
                "finding.followed-by" if last > first + 1 else "finding.followed-by-two",
                first=first,
                last=last,
            )


def _repetition_message(repetition: Repetition) -> Message:
    times, first = Times(repetition.count), Moment(repetition.first)
    if repetition.last is None:
        return Message("finding.repeated.counted", times=times, first=first)
    return Message("finding.repeated", times=times, first=first, last=Moment(repetition.last))


def _consequence_sentence(consequence: Consequence, words: MessageFormatter) -> str:
    clause, after = consequence.clause, consequence.after
    if after <= 0:
        return words("finding.then", clause=clause)
    return words("finding.then-after", clause=clause, after=Duration(after))


def diagnosis_summary(
    severities: Iterable[str],
    totals: TrafficTotals,
    palette: Palette = PLAIN,
    words: MessageFormatter = ENGLISH_WORDS,
) -> str:
    """Return the summary line: the number of findings of each severity, and how much traffic was examined."""
    if not totals.frames:
        return words("diagnosis.nothing")
    counts = Counter(severities)
    found, size = severity_counts_text(counts, words), _size_message(totals)
    if counts[Severity.ERROR] or counts[Severity.WARNING]:
        return words("diagnosis.problems", found=found, size=size)
    none = f"{palette.good}{words('diagnosis.no-problem')}{palette.reset}"
    if found:
        return words("diagnosis.notes", none=none, size=size, found=found)
    return words("diagnosis.healthy", none=none, size=size)


def severity_counts_text(counts: Counter[Any], words: MessageFormatter) -> str:
    found = (words.plural(f"count.{each}", counts[each]) for each in Severity if counts[each])
    return words("list.comma").join(found)


def _size_message(totals: TrafficTotals) -> Message:
    size = Message(
        "diagnosis.size",
        frames=Count(totals.frames, "frame"),
        calls=Count(totals.calls, "call"),
        clients=Count(totals.clients, "client"),
        duration=Duration(totals.duration_ns),
    )
    if totals.not_followed:
        size = Message("diagnosis.size.not-followed", size=size, calls=Count(totals.not_followed, "call"))
    if totals.selected_calls is None:
        return size
    return Message("diagnosis.size.selected", size=size, calls=Count(totals.selected_calls, "call"))
