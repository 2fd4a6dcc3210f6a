"""Findings for people and for programs, and the list of rules."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import orjson

from bcapscope.analysis.finding import Finding, Severity, TrafficTotals
from bcapscope.analysis.rules import RULES
from bcapscope.analysis.rules.rule_checker import DiagnosisRule
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import wrap_text
from bcapscope.render.diagnosis_summary import diagnosis_summary
from bcapscope.render.escape import printable

NARROWEST, WIDEST = 40, 120
"""Columns that text is wrapped to: at least, where the terminal has fewer, and at most, as longer lines are
hard to read."""

_STEP = 4
_DEEPEST = 4


class FindingsRenderer:
    """Writes findings as text, each consequence indented under its cause."""

    def __init__(self, palette: Palette = PLAIN, width: int = 100) -> None:
        self._palette = palette
        self._width = min(max(width, NARROWEST), WIDEST)

    def lines(self, findings: Sequence[Finding], totals: TrafficTotals) -> Iterator[str]:
        """Yield the lines of all findings, in the order given, and one that sums them up."""
        depths: list[int] = []
        for number, finding in enumerate(findings, 1):
            cause = finding.consequence_of
            depths.append(0 if cause is None else depths[cause - 1] + 1)
            yield from self._finding_lines(number, finding, " " * _STEP * min(depths[-1], _DEEPEST))
            yield ""
        yield diagnosis_summary([finding.severity for finding in findings], totals, self._palette)

    def _finding_lines(self, number: int, finding: Finding, indent: str) -> Iterator[str]:
        color = self._palette
        shade = color.problem if finding.severity is Severity.ERROR else color.name
        follows = f", follows from {finding.consequence_of}" if finding.consequence_of is not None else ""
        head = f"{color.number}{number}{color.reset} {shade}{finding.severity}{color.reset}"
        yield f"{indent}{head} {finding.rule}{follows}"
        inner = f"{indent}  "
        yield from self._wrapped_lines(finding.sentence, inner, color.name, "")
        frames = " ".join(map(str, finding.frames))
        yield from self._wrapped_lines(
            frames, inner, color.dim, "frame: " if len(finding.frames) == 1 else "frames: "
        )
        yield from self._wrapped_lines(finding.advice, inner, color.good, "what to do: ")
        yield from self._wrapped_lines(finding.source, inner, color.dim, "source: ")

    def _wrapped_lines(self, text: str, indent: str, shade: str, caption: str) -> Iterator[str]:
        if not text:
            return
        for line in wrap_text(f"{caption}{printable(text)}", max(self._width - len(indent), NARROWEST // 2)):
            yield f"{indent}{shade}{line}{self._palette.reset}"


def finding_record(number: int, finding: Finding) -> bytes:
    """Write one finding as a JSON object; its strings are escaped as on a terminal."""
    return orjson.dumps(
        {
            "finding": number,
            "rule": finding.rule,
            "severity": finding.severity.value,
            "sentence": printable(finding.sentence),
            "frames": list(finding.frames),
            "consequence_of": finding.consequence_of,
            "advice": printable(finding.advice),
            "source": finding.source,
        }
    )


def rule_table(rules: Iterable[DiagnosisRule] = RULES) -> str:
    """Write the list of rules as a Markdown table, the gravest first."""
    rank = list(Severity)
    ordered = sorted(rules, key=lambda rule: rank.index(rule.severity))
    rows = [f"| `{rule.id}` | {rule.severity} | {rule.description} | {rule.source} |" for rule in ordered]
    return "\n".join(("| Rule | Severity | Finds | Source |", "|---|---|---|---|", *rows)) + "\n"
