"""What is to be thought of traffic while it is still being read."""

from __future__ import annotations

import copy

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding
from bcapscope.analysis.statistics import Summary
from bcapscope.analysis.stay import Stay
from bcapscope.render.escape import printable
from bcapscope.render.slave import stay_lines
from bcapscope.render.statistics import statistics_lines
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.tui.ink import INK
from bcapscope.tui.traffic.report import Cause, Verdict

MOST_LINES = 20_000
"""Lines about stays in slave mode that are kept."""


class Judge:
    """Sees all calls and tells at any time what is to be thought of them."""

    def __init__(self, tongue: Tongue = english) -> None:
        """Begin.

        Args:
            tongue: of the rendered lines; findings are told in English.
        """
        self._tongue = tongue
        self._diagnosis = Diagnosis(heed=self._heed)
        self._summary = Summary()
        self._stays: list[str] = []
        self.look = self._diagnosis.take_observation

    def take(self, settled: Settled) -> None:
        """See a call that has settled, or a reply that belongs to none."""
        self._diagnosis.take(settled)
        if isinstance(settled, Exchange):
            self._summary.take(settled)

    def verdict(self, ended: int, present: bool = False) -> Verdict:
        """Tell what is to be thought so far; more may be seen afterwards.

        Args:
            ended: when the traffic ends, for now, in nanoseconds since 1970.
            present: clients that fell silent are known to be still there.
        """
        end = copy.deepcopy(self)
        findings = end._diagnosis.finish(ended, present)
        statistics = self._summary.statistics()
        causes = tuple(map(cause_of, findings))
        lines = [] if statistics is None else list(statistics_lines(statistics, INK, self._tongue))
        return Verdict(causes, end._diagnosis.seen, end._stays, lines)

    def _heed(self, stay: Stay) -> None:
        if len(self._stays) < MOST_LINES:
            self._stays.extend((*stay_lines(stay, INK, self._tongue), ""))


def cause_of(finding: Finding) -> Cause:
    """Make a finding ready to be shown."""
    return Cause(
        finding.rule,
        finding.severity.value,
        printable(finding.sentence),
        finding.frames,
        finding.consequence_of or 0,
        printable(finding.advice),
        finding.source,
    )
