"""The occurrences of a problem that are reported together as one finding."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from bcapscope.analysis.rules.rule_checker import DiagnosisRule, Occurrence

MAX_KEPT = 32
"""Maximum number of first occurrences, and of last occurrences, that are kept for one finding.
"""


class FindingGroup:
    """The occurrences of a problem that are reported together as one finding.

    Attributes:
        selected: True if the finding is about selected calls; False if the finding is reported only as the
            cause of another finding.
        shown: Occurrence that the text of the finding describes. Only the copies of groups that
            `FindingCollector.findings` makes have the attribute `shown`.
    """

    def __init__(self, rule: DiagnosisRule, selected: bool) -> None:
        self.rule = rule
        self.selected = selected
        self.count = 0
        self._earliest: list[Occurrence] = []
        self._latest: deque[Occurrence] = deque(maxlen=MAX_KEPT)
        self._causes: list[Occurrence] = []
        self.shown: Occurrence

    def add(self, occurrence: Occurrence) -> None:
        self.count += occurrence.count
        (self._earliest if len(self._earliest) < MAX_KEPT else self._latest).append(occurrence)

    def keep_cause(self, occurrence: Occurrence) -> None:
        """Keep an occurrence of the problem that has consequences, even if `add` did not keep it."""
        if len(self._causes) < MAX_KEPT and occurrence not in self._causes:
            self._causes.append(occurrence)

    def replace(self, update: Occurrence) -> Occurrence | None:
        """Replace the kept occurrence that has the same call as `update`, and return the replaced occurrence.
        Return None if no occurrence with this call was kept.
        """
        replaced = next((each for each in self if each.call == update.call), None)
        if replaced is not None:
            for kept in (self._earliest, self._latest, self._causes):
                if replaced in kept:
                    kept[kept.index(replaced)] = update
        return replaced

    def copy(self) -> FindingGroup:
        copied = FindingGroup(self.rule, self.selected)
        copied.count = self.count
        copied._earliest, copied._latest = self._earliest.copy(), self._latest.copy()
        copied._causes = self._causes.copy()
        return copied

    def __iter__(self) -> Iterator[Occurrence]:
        """Yield each kept occurrence once."""
        return iter(dict.fromkeys((*self._earliest, *self._causes, *self._latest)))

    @property
    def first(self) -> Occurrence:
        """The kept occurrence that began first."""
        return min(self, key=lambda each: each.began)

    @property
    def last(self) -> Occurrence:
        """The kept occurrence that was completed last."""
        return max(self, key=lambda each: each.completed)
