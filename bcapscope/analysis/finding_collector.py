"""Collect the problems that rules report, link each problem to its cause, and make findings from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from bcapscope.analysis.finding import Consequence, Finding, Repetition, Severity
from bcapscope.analysis.finding_order import MAX_KEPT, FindingGroup, FindingOrder
from bcapscope.analysis.rules.rule_checker import Occurrence

MAX_FINDINGS = 16
"""Maximum number of findings of one rule. If a rule reports a further problem that would need a new finding,
this problem is added to the rule's first finding.
"""

MAX_CALLS = 256
"""Maximum number of calls for which the collector can look up problems by call number. If there are more
calls with problems, the collector forgets the call that it added first.
"""

MAX_FRAMES_NAMED = 16
"""Maximum number of frames that a finding lists for one occurrence of its problem."""

INJECTED = "injected-fault"
"""Id of the rule whose findings are the cause of all other findings about the same call."""

_MAX_NAMED_STEPS = 3
"""Maximum number of consequences that the text of one root cause names."""


class FindingCollector:
    def __init__(self) -> None:
        self._groups: dict[tuple[str, bool, str], FindingGroup] = {}
        self._by_rule: dict[str, list[FindingGroup]] = {}
        self._by_call: dict[int, list[Occurrence]] = {}
        self._explained: dict[int, list[Occurrence]] = {}
        # `MAX_FINDINGS` and `MAX_KEPT` limit the size of `_causes`.
        self._causes: dict[Occurrence, Occurrence] = {}
        self._new_groups: list[FindingGroup] = []

    def add_occurrence(self, occurrence: Occurrence) -> None:
        if occurrence.is_update:
            self._update(occurrence)
            return
        group = self._groups.get((occurrence.rule_id, occurrence.selected, occurrence.group_key))
        group = group or self._open_group(occurrence)
        group.add(occurrence)
        if occurrence.call:
            _append_bounded(self._by_call, occurrence.call, occurrence)
        for number in occurrence.explains:
            _append_bounded(self._explained, number, occurrence)
        if group.count <= MAX_KEPT:
            self._link_cause(occurrence)

    def _update(self, update: Occurrence) -> None:
        replaced = self._group_of(update).replace(update)
        if replaced is None:
            return
        occurrences = self._by_call.get(update.call, [])
        if replaced in occurrences:
            occurrences[occurrences.index(replaced)] = update
        self._causes = {
            update if effect is replaced else effect: update if cause is replaced else cause
            for effect, cause in self._causes.items()
        }

    def _open_group(self, occurrence: Occurrence) -> FindingGroup:
        rule, selected = occurrence.rule, occurrence.selected
        groups = self._by_rule.setdefault(rule.id, [])
        alike = [group for group in groups if group.selected is selected]
        if len(alike) >= MAX_FINDINGS:
            return alike[0]
        group = self._groups[rule.id, selected, occurrence.group_key] = FindingGroup(rule, selected)
        groups.append(group)
        self._new_groups.append(group)
        return group

    def _link_cause(self, occurrence: Occurrence) -> None:
        """Link `occurrence` to its cause. The cause is the first of these problems that exists:

        - an injected fault in `occurrence.call`
        - the latest problem whose `explains` contains `occurrence.call`
        - the latest problem of a call in `occurrence.explaining_calls`
        - the latest problem that `_possible_causes` yields

        `findings` links each kept occurrence again, because a rule may have reported a better cause after the
        first link.
        """
        known = self._causes.pop(occurrence, None)
        injected = [each for each in self._by_call.get(occurrence.call, ()) if each.rule_id == INJECTED]
        if injected and occurrence.rule_id != INJECTED:
            self._set_cause(occurrence, injected[0])
            return
        likely = occurrence.rule.possible_causes
        named = [
            each
            for number in occurrence.explaining_calls
            for each in self._by_call.get(number, ())
            if each.rule.severity is not Severity.NOTE or each.rule_id in likely
        ]
        cause = self._certain_cause(occurrence) or self._best_cause(named, occurrence)
        if cause is None:
            found = [*self._possible_causes(occurrence), *(() if known is None else (known,))]
            cause = self._best_cause(found, occurrence)
        if cause is not None:
            self._set_cause(occurrence, cause)

    def _set_cause(self, occurrence: Occurrence, cause: Occurrence) -> None:
        self._causes[occurrence] = cause
        self._group_of(cause).keep_cause(cause)

    def _certain_cause(self, effect: Occurrence) -> Occurrence | None:
        for each in reversed(self._explained.get(effect.call, ())):
            if effect.call and each is not effect and not self._leads_to(each, effect):
                return each
        return None

    def _best_cause(self, candidates: Sequence[Occurrence], effect: Occurrence) -> Occurrence | None:
        """Return the latest candidate that can be the cause of `effect`. If several candidates began at the
        same time, return the likeliest. A cause begins before `effect` ends, and never follows from `effect`.
        """
        best, best_key = None, (0, 0)
        # Check the latest candidates first, so that `_leads_to` is not called for candidates that began
        # before `best`.
        for each in reversed(candidates):
            if each is effect or each.began > effect.completed or (best and each.began < best.began):
                continue
            key = each.began, -_cause_rank(each.rule_id, effect.rule.possible_causes)
            if (best is None or key >= best_key) and not self._leads_to(each, effect):
                best, best_key = each, key
        return best

    def _leads_to(self, start: Occurrence, goal: Occurrence) -> bool:
        each: Occurrence | None = start
        while each is not None:
            if each is goal:
                return True
            each = self._causes.get(each)
        return False

    def _group_of(self, occurrence: Occurrence) -> FindingGroup:
        known = self._groups.get((occurrence.rule_id, occurrence.selected, occurrence.group_key))
        return known or next(
            group for group in self._by_rule[occurrence.rule_id] if group.selected is occurrence.selected
        )

    def _possible_causes(self, occurrence: Occurrence) -> Iterator[Occurrence]:
        """Yield the possible causes of `occurrence`: problems of the rules in
        `occurrence.rule.possible_causes`.

        Each yielded problem meets one of two conditions:

        - It concerns the same call as `occurrence`.
        - It concerns the same controller, and ended at most `cause_within_ns` before `occurrence` began.
        """
        earliest = occurrence.began - occurrence.rule.cause_within_ns
        host = occurrence.conversation.server.host
        for rule_id in occurrence.rule.possible_causes:
            for group in self._by_rule.get(rule_id, ()):
                for each in group:
                    in_time = each.completed >= earliest and each.conversation.server.host == host
                    if in_time or (occurrence.call and each.call == occurrence.call):
                        yield each

    def new_findings(self) -> tuple[Finding, ...]:
        """Return the new findings about selected calls, without links to their causes."""
        new, self._new_groups = self._new_groups, []
        return tuple(
            _finding(group, group.first, group.first.frames[:MAX_FRAMES_NAMED])
            for group in new
            if group.selected
        )

    def findings(self, provisional: Iterable[Occurrence] = ()) -> tuple[Finding, ...]:
        """Return the findings about selected calls, and the causes of these findings.

        Each root cause is followed by its consequences. Root causes are sorted by `RobotImpact`, then by
        severity, then by time. Impact and severity are the gravest of the root cause and its consequences.
        Root causes of the same client are listed together. The client with the gravest root cause is first.

        Args:
            provisional: Further problems for this result; they are not added to the collector.
        """
        snapshot = self._copy()
        for occurrence in provisional:
            snapshot.add_occurrence(occurrence)
        return snapshot._make_findings()

    def _copy(self) -> FindingCollector:
        copied = FindingCollector()
        groups = {group: group.copy() for group in self._groups.values()}
        copied._groups = {key: groups[group] for key, group in self._groups.items()}
        copied._by_rule = {rule: [groups[group] for group in alike] for rule, alike in self._by_rule.items()}
        copied._by_call = {number: list(occurrences) for number, occurrences in self._by_call.items()}
        copied._explained = {number: list(causes) for number, causes in self._explained.items()}
        copied._causes = self._causes.copy()
        return copied

    def _make_findings(self) -> tuple[Finding, ...]:
        groups = list(self._groups.values())
        for group in groups:
            for occurrence in group:
                self._link_cause(occurrence)
        # Prefer occurrences with consequences, then the gravest impact on the robot, then the earliest time.
        followed = set(self._causes.values())
        for group in groups:
            group.shown = min(
                group, key=lambda each: (each not in followed, each.impact, each.began, each.completed)
            )
        order = FindingOrder(groups, self._causes)
        return tuple(_ordered_finding(group, order) for group in order.groups)


def _append_bounded(by_call: dict[int, list[Occurrence]], number: int, occurrence: Occurrence) -> None:
    by_call.setdefault(number, []).append(occurrence)
    if len(by_call) > MAX_CALLS:
        del by_call[next(iter(by_call))]


def _cause_rank(rule_id: str, likely: tuple[str, ...]) -> int:
    return likely.index(rule_id) if rule_id in likely else len(likely)


def _finding(group: FindingGroup, shown: Occurrence, frames: tuple[int, ...]) -> Finding:
    rule = group.rule
    return Finding(
        rule=rule.id,
        severity=rule.severity,
        fact=shown.fact,
        frames=frames,
        consequence_of=None,
        advice=shown.advice or rule.advice,
        source=rule.source,
        calls=(shown.call,) if shown.call else (),
        conversation=shown.conversation,
        began=shown.began,
    )


def _ordered_finding(group: FindingGroup, order: FindingOrder) -> Finding:
    cause, finding = order.parent(group), _finding(group, group.shown, _frames(group))
    finding = replace(finding, consequence_of=cause, repetition=_repetition(group))
    return _with_consequences(finding, group, order) if cause is None else finding


def _repetition(group: FindingGroup) -> Repetition | None:
    if group.count < 2:
        return None
    all_listed = all(occurrence.count == 1 for occurrence in group)
    return Repetition(group.count, group.first.began, group.last.completed if all_listed else None)


def _with_consequences(finding: Finding, root: FindingGroup, order: FindingOrder) -> Finding:
    """Return a copy of `finding` with the text and the delay of each of its first consequences. If there are
    further consequences, or further occurrences of a consequence, the copy also has the finding numbers of
    its first and last consequence.
    """
    named: list[Consequence] = []
    time = root.shown.completed
    for group in order.first_consequences(root):
        clause = group.shown.clause
        if clause is None or len(named) == _MAX_NAMED_STEPS:
            break
        named.append(Consequence(clause, group.shown.completed - time))
        time = group.shown.completed
    family = list(order.with_consequences(root))
    followed_by, explains_rest = None, False
    if len(family) - 1 > len(named) or any(group.count > 1 for group in family[1:]):
        followed_by = order.number(family[1]), order.number(family[-1])
        explains_rest = order.explains_the_rest(root)
    return replace(finding, consequences=tuple(named), followed_by=followed_by, explains_rest=explains_rest)


def _frames(group: FindingGroup) -> tuple[int, ...]:
    """Return the frames of the shown occurrence, and one frame each of the first and the last occurrence."""
    frames = list(group.shown.frames)
    if len(frames) > MAX_FRAMES_NAMED:
        frames = [*frames[: MAX_FRAMES_NAMED // 2], *frames[-MAX_FRAMES_NAMED // 2 :]]
    if group.count > 1:
        frames += [*group.first.frames[:1], *group.last.frames[-1:]]
    return tuple(sorted(set(frames)))
