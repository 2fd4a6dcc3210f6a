"""The diagnosis of traffic that is still being read."""

from __future__ import annotations

from functools import partial

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, TrafficTotals
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import StatisticsBuilder
from bcapscope.messages import ENGLISH_WORDS, Language, MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.render.findings import finding_sentence, words_for
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.render.statistics_text import statistics_lines
from bcapscope.traffic.pipeline import PipelineSubscriber
from bcapscope.tui.ink import INK
from bcapscope.tui.traffic_processes.process_messages import ShownFinding, TrafficAnalysis

MAX_LINES = 20_000
"""After this number of lines, the analysis omits further slave-mode sessions."""


class RunningDiagnosis:
    def __init__(self, words: MessageFormatter = ENGLISH_WORDS) -> None:
        self._words = words
        self._session_lines: list[str] = []
        self.diagnosis = Diagnosis(on_slave_session=partial(self._add_slave_session, self._session_lines))
        self._statistics = StatisticsBuilder()
        self.subscribers: tuple[PipelineSubscriber, ...] = self.diagnosis, self._statistics

    def snapshot(self, ended: int, present: bool = False) -> TrafficAnalysis:
        """Return the analysis as if the traffic ended at `ended`, in ns since 1970. `present` means that the
        clients are still connected, even if they are silent.
        """
        statistics, totals = self._statistics.statistics(), self.diagnosis.totals(ended)
        findings = tuple(shown_finding(each, totals) for each in self.diagnosis.findings(ended, present))
        session_lines = self._session_lines.copy()
        for session in self.diagnosis.remaining_sessions(ended):
            self._add_slave_session(session_lines, session)
        lines = [] if statistics is None else list(statistics_lines(statistics, INK, self._words))
        return TrafficAnalysis(findings, totals, session_lines, lines)

    def _add_slave_session(self, lines: list[str], session: SlaveSession) -> None:
        if len(lines) < MAX_LINES:
            lines.extend((*slave_session_lines(session, INK, self._words), ""))


def shown_finding(finding: Finding, totals: TrafficTotals) -> ShownFinding:
    all_words = [words_for(MessageFormatter(language), totals) for language in Language]
    return ShownFinding(
        finding.rule,
        finding.severity.value,
        {words.language.value: printable(finding_sentence(finding, words)) for words in all_words},
        finding.frames,
        finding.consequence_of or 0,
        {words.language.value: printable(words.text(finding.advice)) for words in all_words},
        finding.source,
    )
