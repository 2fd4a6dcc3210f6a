"""Findings as text and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import orjson

from bcapscope.analysis.finding import Finding, Severity, TrafficTotals
from bcapscope.capture.capture_sequence import PacketOrigin
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.message import message_params
from bcapscope.messages.places import frames_text
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import wrap_text
from bcapscope.render.diagnosis_summary import diagnosis_summary
from bcapscope.render.escape import printable
from bcapscope.render.finding_text import finding_depths, finding_sentence, words_for
from bcapscope.render.json_values import packet_objects

NARROWEST, WIDEST = 40, 120
"""Limits of the text width in columns. Narrower terminals get the minimum; longer lines are hard to read."""

_STEP = 4


class FindingsRenderer:
    """Writes findings as text, each consequence indented under its cause."""

    def __init__(
        self, palette: Palette = PLAIN, width: int = 100, words: MessageFormatter = ENGLISH_WORDS
    ) -> None:
        self._palette = palette
        self._words = words
        self._width = min(max(width, NARROWEST), WIDEST)

    def lines(self, findings: Sequence[Finding], totals: TrafficTotals) -> Iterator[str]:
        """Yield the lines of all findings in the given order, then one line with a summary."""
        words = words_for(self._words, totals)
        for number, (finding, depth) in enumerate(zip(findings, finding_depths(findings), strict=True), 1):
            yield from self._finding_lines(number, finding, " " * _STEP * depth, words)
            yield ""
        yield diagnosis_summary([finding.severity for finding in findings], totals, self._palette, words)

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
) -> bytes:
    """Return a finding as a JSON object with English text. Non-printable characters in texts are escaped.

    `origin_of` returns the capture and the packet of a frame by its number.
    """
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
            "count": 1 if finding.repetition is None else finding.repetition.count,
            "packets": packet_objects(finding.frames, origin_of),
        }
    )
