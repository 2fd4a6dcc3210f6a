"""What is to be thought of traffic while it is still being read."""

from __future__ import annotations

import copy

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import StatisticsBuilder
from bcapscope.render.escape import printable
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.render.statistics_text import statistics_lines
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.tui.ink import INK
from bcapscope.tui.traffic_processes.process_messages import ShownFinding, TrafficAnalysis

MAX_LINES = 20_000
"""Lines about stays in slave mode that are kept."""


class RunningDiagnosis:
    """Sees all calls and tells at any time what is to be thought of them."""

    def __init__(self, tongue: Tongue = english) -> None:
        """Begin.

        Args:
            tongue: of the rendered lines; findings are told in English.
        """
        self._tongue = tongue
        self._diagnosis = Diagnosis(on_slave_session=self._on_slave_session)
        self._summary = StatisticsBuilder()
        self._slave_session_lines: list[str] = []
        self.on_observation = self._diagnosis.on_observation

    def on_settled(self, settled: PairingResult) -> None:
        """See a call that has settled, or a reply that belongs to none."""
        self._diagnosis.on_pairing_result(settled)
        if isinstance(settled, Call):
            self._summary.add_call(settled)

    def snapshot(self, ended: int, present: bool = False) -> TrafficAnalysis:
        """Tell what is to be thought so far; more may be seen afterwards.

        Args:
            ended: when the traffic ends, for now, in nanoseconds since 1970.
            present: clients that fell silent are known to be still there.
        """
        end = copy.deepcopy(self)
        findings = end._diagnosis.finish(ended, present)
        statistics = self._summary.statistics()
        causes = tuple(map(shown_finding, findings))
        lines = [] if statistics is None else list(statistics_lines(statistics, INK, self._tongue))
        return TrafficAnalysis(causes, end._diagnosis.totals, end._slave_session_lines, lines)

    def _on_slave_session(self, slave_session: SlaveSession) -> None:
        if len(self._slave_session_lines) < MAX_LINES:
            self._slave_session_lines.extend((*slave_session_lines(slave_session, INK, self._tongue), ""))


def shown_finding(finding: Finding) -> ShownFinding:
    """Make a finding ready to be shown."""
    return ShownFinding(
        finding.rule,
        finding.severity.value,
        printable(finding.sentence),
        finding.frames,
        finding.consequence_of or 0,
        printable(finding.advice),
        finding.source,
    )
