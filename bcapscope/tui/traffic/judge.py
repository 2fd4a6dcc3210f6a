"""What is to be thought of traffic while it is still being read."""

from __future__ import annotations

import copy

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.slave import SlaveWatcher
from bcapscope.analysis.statistics import Summary
from bcapscope.analysis.stay import Stay
from bcapscope.render.escape import printable
from bcapscope.render.slave import stay_lines
from bcapscope.render.statistics import statistics_lines
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.tui.ink import INK
from bcapscope.tui.traffic.report import Cause, Verdict

MOST_LINES = 20_000
"""Lines about stays in slave mode that are kept."""


class Judge:
    """Sees all calls and tells at any time what is to be thought of them."""

    def __init__(self) -> None:
        self._diagnosis = Diagnosis()
        self._watcher = SlaveWatcher()
        self._summary = Summary()
        self._stays: list[str] = []
        self.look = self._diagnosis.take_observation

    def take(self, settled: Settled) -> None:
        """See a call that has settled, or a reply that belongs to none."""
        self._diagnosis.take(settled)
        if isinstance(settled, Exchange):
            self._summary.take(settled)
            for stay in self._watcher.take(settled):
                self._tell(self._stays, stay)

    def verdict(self) -> Verdict:
        """Tell; more may be seen afterwards."""
        diagnosis, watcher = copy.deepcopy((self._diagnosis, self._watcher))
        findings = diagnosis.finish()
        stays = list(self._stays)
        for stay in watcher.finish():
            self._tell(stays, stay)
        statistics = self._summary.statistics()
        causes = tuple(
            Cause(
                each.rule,
                each.severity.value,
                printable(each.sentence),
                each.frames,
                each.consequence_of or 0,
                printable(each.advice),
                each.source,
            )
            for each in findings
        )
        lines = [] if statistics is None else list(statistics_lines(statistics, INK))
        return Verdict(causes, diagnosis.seen, stays, lines)

    @staticmethod
    def _tell(lines: list[str], stay: Stay) -> None:
        if len(lines) < MOST_LINES:
            lines.extend((*stay_lines(stay, INK), ""))
