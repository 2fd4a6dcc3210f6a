"""Findings as text and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import orjson

from bcapscope.analysis.finding import Finding, Severity, TrafficTotals
from bcapscope.capture.capture_sequence import PacketOrigin
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.message import message_params
from bcapscope.messages.places import Count, frames_text
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.finding_text import diagnosis_summary, finding_depths, finding_sentence, words_for
from bcapscope.render.json_values import packet_objects, time_fragment

NARROWEST, WIDEST = 40, 120
"""Minimum and maximum width of the text in columns. The minimum holds even on a narrower terminal; lines
longer than the maximum would be hard to read."""

_STEP = 4


class FindingsRenderer:
    def __init__(
        self,
        palette: Palette = PLAIN,
        width: int = 100,
        words: MessageFormatter = ENGLISH_WORDS,
        filter_lines: Callable[[Finding], Iterable[str]] | None = None,
    ) -> None:
        """Create a renderer. `filter_lines` returns the lines with a finding's display filters. The renderer
        never wraps these lines.
        """
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
        """Yield the lines of each finding if `is_shown` returns True for this finding. Keep the order of
        `findings`. Then yield a summary of all findings.
        """
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
    """Return a finding as a JSON object with English text. Non-printable characters in texts are escaped.

    Args:
        origin_of: Takes the number of a frame, and returns its capture and packet.
        is_final: Whether the traffic has ended. Before the end of the traffic, the causes and repetitions of
            a finding are not known.
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
