"""Findings with their texts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Literal

from bcapscope.analysis.finding import NO_TRAFFIC, Finding, TrafficTotals
from bcapscope.api.opened_capture import choose
from bcapscope.messages import Language, MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.render.findings import finding_sentence, words_for

_LANGUAGES = {language.value: language for language in Language}


@dataclass(frozen=True, slots=True)
class ReportedFinding(Finding):
    """A finding of a capture, with its number and its texts.

    Attributes:
        number: Number of the finding, counted from 1 in the order of the report.
        totals: Amount of traffic that was examined.
    """

    number: int = 0
    totals: TrafficTotals = NO_TRAFFIC
    _find_frame: Callable[[int], tuple[str, int] | None] | None = field(
        default=None, repr=False, compare=False
    )

    def text(self, language: Literal["en", "ja"] = "en") -> str:
        """Return what happened, how often, and what followed. Text from the wire is escaped.

        Raises:
            InputError: The language is unknown.
        """
        return printable(finding_sentence(self, self._words(language)))

    def advice_text(self, language: Literal["en", "ja"] = "en") -> str:
        """Return what you can do about the finding. Raises InputError if the language is unknown."""
        return printable(self._words(language).text(self.advice))

    def _words(self, language: Literal["en", "ja"]) -> MessageFormatter:
        return words_for(
            MessageFormatter(choose(language, _LANGUAGES), find_frame=self._find_frame), self.totals
        )


def reported_finding(
    number: int,
    finding: Finding,
    totals: TrafficTotals,
    find_frame: Callable[[int], tuple[str, int] | None] | None,
) -> ReportedFinding:
    """Return a finding for users of the package. If `find_frame` is None, the text of the finding has only
    frame numbers.
    """
    values = {each.name: getattr(finding, each.name) for each in fields(Finding)}
    return ReportedFinding(**values, number=number, totals=totals, _find_frame=find_frame)
