"""Sentences about findings, in the reader's language."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.analysis.finding import Consequence, Finding, Repetition, TrafficTotals
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.places import Duration, Moment, Times

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
