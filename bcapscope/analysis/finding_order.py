"""Group occurrences into findings, sort the findings, and link each finding to its cause."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping

from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule_checker import Occurrence, RobotImpact
from bcapscope.analysis.rules.rule_table import DiagnosisRule

MAX_KEPT = 32
"""Maximum number of first occurrences, and of last occurrences, that are kept for one finding."""


class FindingGroup:
    """Occurrences of one problem that bcapscope reports as one finding.

    Attributes:
        selected: False if the finding is reported only as the cause of a finding about selected calls.
        shown: Occurrence that the finding describes; set only in the copies that `FindingCollector` makes.
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
        """Keep an occurrence that has consequences, even if `add` did not keep it."""
        if len(self._causes) < MAX_KEPT and occurrence not in self._causes:
            self._causes.append(occurrence)

    def replace(self, update: Occurrence) -> Occurrence | None:
        """Replace the kept occurrence that has the same call number as `update`. Return the replaced
        occurrence; None if no kept occurrence has this call number.
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
        return min(self, key=lambda each: each.began)

    @property
    def last(self) -> Occurrence:
        return max(self, key=lambda each: each.completed)


_RANK = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}


class FindingOrder:
    """The findings about selected calls, and the causes of these findings, in the order of the report."""

    def __init__(self, groups: list[FindingGroup], causes: Mapping[Occurrence, Occurrence]) -> None:
        self._parents = _parent_groups(groups, causes)
        kept: set[FindingGroup] = set()
        for group in groups:
            each: FindingGroup | None = group if group.selected else None
            while each is not None and each not in kept:
                kept.add(each)
                each = self._parents.get(each)
        self._children: dict[FindingGroup | None, list[FindingGroup]] = {}
        in_time = [group for group in groups if group in kept]
        for group in sorted(in_time, key=lambda each: (each.shown.began, _RANK[each.rule.severity])):
            self._children.setdefault(self._parents.get(group), []).append(group)
        roots = self._ordered_roots(self._children.get(None, []))
        self.groups = [group for root in roots for group in self.with_consequences(root)]
        self._numbers = {group: number for number, group in enumerate(self.groups, 1)}

    def number(self, group: FindingGroup) -> int:
        return self._numbers[group]

    def parent(self, group: FindingGroup) -> int | None:
        """Return the number of the finding that caused this group; None if the group is a root cause."""
        parent = self._parents.get(group)
        return None if parent is None else self.number(parent)

    def with_consequences(self, group: FindingGroup) -> Iterator[FindingGroup]:
        yield group
        for child in self._children.get(group, ()):
            yield from self.with_consequences(child)

    def first_consequences(self, group: FindingGroup) -> Iterator[FindingGroup]:
        """Yield the first consequence of a group, the first consequence of that consequence, and so on."""
        while self._children.get(group):
            group = self._children[group][0]
            yield group

    def _ordered_roots(self, roots: list[FindingGroup]) -> list[FindingGroup]:
        """Sort root causes by client, effect on the robot and severity. `roots` must be in order of time."""
        ranked = sorted(roots, key=lambda root: (self._impact(root), self._worst_severity(root)))
        clients = dict.fromkeys(root.shown.conversation for root in ranked)
        rank = {client: number for number, client in enumerate(clients)}
        return sorted(ranked, key=lambda root: rank[root.shown.conversation])

    def _impact(self, group: FindingGroup) -> RobotImpact:
        family = self.with_consequences(group)
        return min(occurrence.impact for each in family for occurrence in each)

    def _worst_severity(self, group: FindingGroup) -> int:
        return min(_RANK[each.rule.severity] for each in self.with_consequences(group))

    def explains_the_rest(self, group: FindingGroup) -> bool:
        """Return whether this group caused all errors and warnings that began after it."""
        family = set(self.with_consequences(group))
        return all(
            each in family
            or each.rule.severity is Severity.NOTE
            or max(occurrence.began for occurrence in each) <= group.shown.completed
            for each in self.groups
        )


def _parent_groups(
    groups: list[FindingGroup], causes: Mapping[Occurrence, Occurrence]
) -> dict[FindingGroup, FindingGroup]:
    """Map each group to its parent: the group that contains the cause of the occurrence `group.shown`. Omit
    groups without a cause, and links that would close a cycle.
    """
    group_of = {occurrence: group for group in groups for occurrence in group}
    parents: dict[FindingGroup, FindingGroup] = {}
    for group in sorted(groups, key=lambda each: each.shown.began):
        cause = causes.get(group.shown)
        parent = group_of.get(cause) if cause is not None else None
        above = parent
        while above is not None and above is not group:
            above = parents.get(above)
        if parent is not None and above is None:
            parents[group] = parent
    return parents
