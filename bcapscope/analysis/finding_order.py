"""The order of the findings in the report, and the cause of each finding."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from bcapscope.analysis.finding import Severity
from bcapscope.analysis.finding_group import FindingGroup
from bcapscope.analysis.rules.rule_checker import Occurrence, RobotImpact

_RANK = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}


def _parent_groups(
    groups: list[FindingGroup], causes: Mapping[Occurrence, Occurrence]
) -> dict[FindingGroup, FindingGroup]:
    """Map each group to the group that caused its shown occurrence. Links that would form a cycle are left
    out.
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


def selected_groups(
    groups: list[FindingGroup], causes: Mapping[Occurrence, Occurrence]
) -> list[FindingGroup]:
    """Return the selected groups, and the groups that caused them directly or indirectly."""
    parents = _parent_groups(groups, causes)
    kept: set[FindingGroup] = set()
    for group in groups:
        each: FindingGroup | None = group if group.selected else None
        while each is not None and each not in kept:
            kept.add(each)
            each = parents.get(each)
    return [group for group in groups if group in kept]


class FindingOrder:
    """The order of the findings in the report, and the links from each finding to its cause."""

    def __init__(self, groups: list[FindingGroup], causes: Mapping[Occurrence, Occurrence]) -> None:
        self._parents = _parent_groups(groups, causes)
        self._children: dict[FindingGroup | None, list[FindingGroup]] = {}
        for group in sorted(groups, key=lambda each: (each.shown.began, _RANK[each.rule.severity])):
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
        """Yield a group and all its direct and indirect consequences."""
        yield group
        for child in self._children.get(group, ()):
            yield from self.with_consequences(child)

    def first_consequences(self, group: FindingGroup) -> Iterator[FindingGroup]:
        """Yield the first consequence of a group, then the first consequence of this consequence, and so
        on.
        """
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
