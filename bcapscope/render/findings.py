"""Findings as text and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import orjson

from bcapscope.analysis.finding import Consequence, Finding, Repetition, Severity, TrafficTotals
from bcapscope.capture.packet import PacketOrigin
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.message import message_params
from bcapscope.messages.places import Count, Duration, Moment, Times, frames_text
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.json_values import packet_objects, time_fragment

NARROWEST, WIDEST = 40, 120
"""Minimum and maximum width of a line in columns. The minimum applies even on a narrower terminal."""

_STEP = 4


class FindingsRenderer:
    def __init__(
        self,
        palette: Palette = PLAIN,
        width: int = 100,
        words: MessageFormatter = ENGLISH_WORDS,
        filter_lines: Callable[[Finding], Iterable[str]] | None = None,
    ) -> None:
        """`filter_lines` returns the display filters of a finding as lines. These lines are never wrapped."""
        self._palette = palette
        self._words = words
        self._filter_lines = filter_lines
        self._width = min(max(width, NARROWEST), WIDEST)

    def lines(
        self,
        findings: Sequence[Finding],
        totals: TrafficTotals,
        is_shown: Callable[[Finding], bool] = lambda finding: True,
    ) -> Iterator[str]:
        """Yield the lines of each finding that `is_shown` selects, then a summary of all findings."""
        words = words_for(self._words, totals)
        shown = [is_shown(finding) for finding in findings]
        depths = finding_depths(findings) if all(shown) else [0] * len(findings)
        for number, (finding, depth) in enumerate(zip(findings, depths, strict=True), 1):
            if shown[number - 1]:
                yield from self._finding_lines(number, finding, " " * _STEP * depth, words)
                yield ""
        yield diagnosis_summary([finding.severity for finding in findings], totals, self._palette, words)
        if not all(shown):
            yield words("diagnosis.shown", shown=sum(shown), findings=Count(len(findings), "finding"))

    def new_finding_line(self, finding: Finding, totals: TrafficTotals) -> str:
        words = words_for(self._words, totals)
        severity = words(f"severity.{finding.severity}")
        head = f"{self._palette.problem}{severity}{self._palette.reset} {finding.rule}"
        return f"{head}: {printable(finding_sentence(finding, words))}"

    def _finding_lines(
        self, number: int, finding: Finding, indent: str, words: MessageFormatter
    ) -> Iterator[str]:
        color = self._palette
        shade = color.problem if finding.severity is Severity.ERROR else color.name
        head = (
            f"{color.number}{number}{color.reset} {shade}{words(f'severity.{finding.severity}')}{color.reset}"
        )
        rule = finding.rule
        if finding.consequence_of is not None:
            rule = words("finding.label.follows", rule=rule, number=finding.consequence_of)
        yield f"{indent}{head} {rule}"
        inner = f"{indent}  "
        yield from self._wrapped_lines(finding_sentence(finding, words), inner, color.name)
        label = "frame" if len(finding.frames) == 1 else "frames"
        frames = words(f"finding.label.{label}", frames=frames_text(finding.frames, words, " "))
        yield from self._wrapped_lines(frames if finding.frames else "", inner, color.dim)
        if self._filter_lines is not None and finding.frames:
            for line in self._filter_lines(finding):
                yield f"{inner}{color.dim}{line}{color.reset}"
        yield from self._wrapped_lines(
            words("finding.label.advice", advice=finding.advice), inner, color.good
        )
        source = words("finding.label.source", source=finding.source) if finding.source else ""
        yield from self._wrapped_lines(source, inner, color.dim)

    def _wrapped_lines(self, text: str, indent: str, shade: str) -> Iterator[str]:
        if not text:
            return
        for line in wrap_text(printable(text), max(self._width - len(indent), NARROWEST // 2)):
            yield f"{indent}{shade}{line}{self._palette.reset}"


def finding_record(
    number: int,
    finding: Finding,
    totals: TrafficTotals,
    origin_of: Callable[[int], PacketOrigin | None] = lambda frame: None,
    is_final: bool = True,
) -> bytes:
    """Return a finding as a JSON object with escaped English text.

    `origin_of` takes the number of a frame. `is_final` says whether the traffic has ended. Before the
    end, the causes and repetitions of a finding are not known.
    """
    repetition = finding.repetition
    words = words_for(ENGLISH_WORDS, totals)
    return orjson.dumps(
        {
            "finding": number,
            "rule": finding.rule,
            "severity": finding.severity.value,
            "sentence": printable(finding_sentence(finding, words)),
            "frames": list(finding.frames),
            "consequence_of": finding.consequence_of,
            "advice": printable(words.text(finding.advice)),
            "source": finding.source,
            "params": message_params(finding.fact),
            "began": finding.began,
            "calls": list(finding.calls),
            "client": str(finding.conversation.client),
            "count": 1 if repetition is None else repetition.count,
            "packets": packet_objects(finding.frames, origin_of),
            "time": time_fragment(finding.began),
            "t": (finding.began - totals.began) / 1e9,
            "first": None if repetition is None else time_fragment(repetition.first),
            "last": None if repetition is None or repetition.last is None else time_fragment(repetition.last),
            "server": str(finding.conversation.server),
            "transport": finding.conversation.transport.value,
            "final": is_final,
        }
    )


_DEEPEST = 4


def words_for(words: MessageFormatter, totals: TrafficTotals) -> MessageFormatter:
    """Return a formatter that writes times relative to the start of the traffic."""
    return words.for_report(totals.began, totals.has_only_client)


def finding_sentence(finding: Finding, words: MessageFormatter) -> str:
    """Say what happened, how often, and what followed. Strings from the wire are not escaped."""
    return words.sentences(_sentences(finding, words))


def finding_depths(findings: Sequence[Finding]) -> list[int]:
    """Return the depth of each finding: 0 without a cause, else the depth of the cause plus 1, at most 4."""
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
