"""Incidents are collected here, tied to what they follow from, and told as findings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.rules.rule_checker import DiagnosisRule, Occurrence
from bcapscope.analysis.speech import Speech, times

MAX_KEPT = 32
"""Incidents of one finding that are kept from the beginning, and as many from the end."""

MAX_FINDINGS = 16
"""Findings of one rule, where it tells several apart; what comes beyond joins the first."""

MAX_CALLS = 256
"""Calls whose incidents can be found by their number, the latest: what explains a call is not long ago. An
incident may hold all that is known of a stay in slave mode, some 20 kB."""

MAX_FRAMES_NAMED = 16
"""Frames that a finding names."""

_MAX_NAMED_STEPS = 3
"""Consequences that the sentence of a root tells one by one."""

_OPENERS = frozenset(("the", "your", "client", "a", "at", "that", "after", "frame", "another", "slave"))
"""Words of ours that a sentence may begin with; names from the wire stay as they are."""

_RANK = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}


class FindingGroup:
    """All incidents that become one finding.

    Attributes:
        rule: of all.
        selected: whether it is to be told for itself, as its incidents are.
        count: how many there were.
        shown: the one that is told; set by `FindingCollector.findings`.
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
        """Take one more."""
        self.count += occurrence.count
        (self._earliest if len(self._earliest) < MAX_KEPT else self._latest).append(occurrence)

    def keep_cause(self, occurrence: Occurrence) -> None:
        """Keep one that had consequences, whatever comes after it."""
        if len(self._causes) < MAX_KEPT and occurrence not in self._causes:
            self._causes.append(occurrence)

    def __iter__(self) -> Iterator[Occurrence]:
        """Yield those that are kept, each once."""
        return iter(dict.fromkeys((*self._earliest, *self._causes, *self._latest)))

    @property
    def first(self) -> Occurrence:
        """The one that began first, of those kept."""
        return min(self, key=lambda each: each.began)

    @property
    def last(self) -> Occurrence:
        """The one that was over last, of those kept."""
        return max(self, key=lambda each: each.completed)


class FindingCollector:
    """Takes incidents in the order in which rules find them, which is not always that of their times."""

    def __init__(self) -> None:
        self._groups: dict[tuple[str, bool, str], FindingGroup] = {}
        self._by_rule: dict[str, list[FindingGroup]] = {}
        self._by_call: dict[int, list[Occurrence]] = {}
        self._new_groups: list[FindingGroup] = []

    def add_occurrence(self, occurrence: Occurrence) -> None:
        """Take an incident in."""
        rule = occurrence.rule
        case = self._groups.get((rule.id, occurrence.selected, occurrence.group_key)) or self._open_group(
            occurrence
        )
        case.add(occurrence)
        if occurrence.call:
            self._by_call.setdefault(occurrence.call, []).append(occurrence)
            if len(self._by_call) > MAX_CALLS:
                del self._by_call[next(iter(self._by_call))]
        if case.count <= MAX_KEPT:
            self._link_cause(occurrence)

    def _open_group(self, occurrence: Occurrence) -> FindingGroup:
        rule, asked = occurrence.rule, occurrence.selected
        cases = self._by_rule.setdefault(rule.id, [])
        alike = [case for case in cases if case.selected is asked]
        if len(alike) >= MAX_FINDINGS:
            return alike[0]
        case = self._groups[rule.id, asked, occurrence.group_key] = FindingGroup(rule, asked)
        cases.append(case)
        self._new_groups.append(case)
        return case

    def _link_cause(self, occurrence: Occurrence) -> None:
        """Look for what an incident follows from: the calls that it names, else what came last before it.

        Called again when all is known: what was found last may have come before, and fits better.
        """
        known, occurrence.cause = occurrence.cause, None
        likely = occurrence.rule.possible_causes
        named = [
            each
            for number in occurrence.explaining_calls
            for each in self._by_call.get(number, ())
            if each.rule.severity is not Severity.NOTE or each.rule.id in likely
        ]
        causes = [each for each in named if _can_cause(each, occurrence)]
        if not causes:
            found = list(self._possible_causes(occurrence)) + ([] if known is None else [known])
            causes = [each for each in found if _can_cause(each, occurrence)]
        if causes:
            occurrence.cause = max(causes, key=lambda each: (each.began, -_cause_rank(each.rule.id, likely)))
            self._group_of(occurrence.cause).keep_cause(occurrence.cause)

    def _group_of(self, occurrence: Occurrence) -> FindingGroup:
        known = self._groups.get((occurrence.rule.id, occurrence.selected, occurrence.group_key))
        return known or next(
            case for case in self._by_rule[occurrence.rule.id] if case.selected is occurrence.selected
        )

    def _possible_causes(self, occurrence: Occurrence) -> Iterator[Occurrence]:
        earliest, host = (
            occurrence.began - occurrence.rule.cause_within_ns,
            occurrence.conversation.server.host,
        )
        for rule_id in occurrence.rule.possible_causes:
            for case in self._by_rule.get(rule_id, ()):
                for each in case:
                    if each.completed >= earliest and each.conversation.server.host == host:
                        yield each

    def new_findings(self, speech: Speech) -> tuple[Finding, ...]:
        """Tell the cases that are new since the last time; what follows from what shows later."""
        new, self._new_groups = self._new_groups, []
        return tuple(
            Finding(
                rule=case.rule.id,
                severity=case.rule.severity,
                sentence=_as_sentence(case.first.say(speech)),
                frames=case.first.frames[:MAX_FRAMES_NAMED],
                consequence_of=None,
                advice=case.first.advice or case.rule.advice,
                source=case.rule.source,
            )
            for case in new
            if case.selected
        )

    def findings(self, speech: Speech) -> tuple[Finding, ...]:
        """Tell all cases that are asked for and what these follow from.

        Each root comes with its consequences behind it, the gravest and earliest root first.
        """
        cases = list(self._groups.values())
        for case in cases:
            for incident in case:
                self._link_cause(incident)
        self._choose_shown(cases)
        order = _FindingOrder(_selected_groups(cases))
        return tuple(
            Finding(
                rule=case.rule.id,
                severity=case.rule.severity,
                sentence=_sentence(case, order, speech),
                frames=_frames(case),
                consequence_of=order.parent(case),
                advice=case.shown.advice or case.rule.advice,
                source=case.rule.source,
            )
            for case in order.groups
        )

    def _choose_shown(self, groups: Iterable[FindingGroup]) -> None:
        """Choose the incident to be told: the first that has consequences, else the first."""
        followed = {id(incident.cause) for case in groups for incident in case if incident.cause is not None}
        for case in groups:
            case.shown = min(case, key=lambda each: (id(each) not in followed, each.began, each.completed))


def _cause_rank(rule_id: str, likely: tuple[str, ...]) -> int:
    return likely.index(rule_id) if rule_id in likely else len(likely)


def _can_cause(cause: Occurrence, effect: Occurrence) -> bool:
    """Tell whether one can be the cause of the other."""
    return cause is not effect and cause.began <= effect.completed and not _leads_to(cause, effect)


def _leads_to(start: Occurrence, goal: Occurrence) -> bool:
    each: Occurrence | None = start
    while each is not None:
        if each is goal:
            return True
        each = each.cause
    return False


def _parent_groups(groups: list[FindingGroup]) -> dict[int, FindingGroup]:
    """Map each case to that of its chosen incident's cause, where this leads back to no case twice."""
    home = {id(incident): case for case in groups for incident in case}
    parents: dict[int, FindingGroup] = {}
    for case in sorted(groups, key=lambda each: each.shown.began):
        cause = case.shown.cause
        parent = home.get(id(cause)) if cause is not None else None
        above = parent
        while above is not None and above is not case:
            above = parents.get(id(above))
        if parent is not None and above is None:
            parents[id(case)] = parent
    return parents


def _selected_groups(groups: list[FindingGroup]) -> list[FindingGroup]:
    """Leave off what is not asked for and leads to nothing that is."""
    parents = _parent_groups(groups)
    kept: set[int] = set()
    for case in groups:
        each: FindingGroup | None = case if case.selected else None
        while each is not None and id(each) not in kept:
            kept.add(id(each))
            each = parents.get(id(each))
    return [case for case in groups if id(case) in kept]


class _FindingOrder:
    """The cases in the order in which they are told, and which follow from which."""

    def __init__(self, groups: list[FindingGroup]) -> None:
        parents = _parent_groups(groups)
        self._children: dict[int, list[FindingGroup]] = {}
        for case in sorted(groups, key=lambda each: (each.shown.began, _RANK[each.rule.severity])):
            parent = parents.get(id(case))
            self._children.setdefault(0 if parent is None else id(parent), []).append(case)
        roots = sorted(self._children.get(0, ()), key=self._worst_severity)
        self.groups = [case for root in roots for case in self.with_consequences(root)]
        self._numbers = {id(case): number for number, case in enumerate(self.groups, 1)}
        self._parents = parents

    def number(self, group: FindingGroup) -> int:
        return self._numbers[id(group)]

    def parent(self, group: FindingGroup) -> int | None:
        """Return the number of what a case follows from."""
        parent = self._parents.get(id(group))
        return None if parent is None else self.number(parent)

    def with_consequences(self, group: FindingGroup) -> Iterator[FindingGroup]:
        """Yield a case and all that follows from it."""
        yield group
        for child in self._children.get(id(group), ()):
            yield from self.with_consequences(child)

    def first_consequences(self, group: FindingGroup) -> Iterator[FindingGroup]:
        """Yield what followed first from a case, what followed first from that, and so on."""
        while self._children.get(id(group)):
            group = self._children[id(group)][0]
            yield group

    def _worst_severity(self, group: FindingGroup) -> int:
        return min(_RANK[each.rule.severity] for each in self.with_consequences(group))

    def explains_the_rest(self, group: FindingGroup) -> bool:
        """Tell whether all that went wrong later follows from this case."""
        family = {id(each) for each in self.with_consequences(group)}
        return all(
            id(each) in family
            or each.rule.severity is Severity.NOTE
            or max(incident.began for incident in each) <= group.shown.completed
            for each in self.groups
        )


def _sentence(case: FindingGroup, order: _FindingOrder, speech: Speech) -> str:
    chosen = case.shown
    text = chosen.say(speech)
    if case.count > 1:
        listed = all(incident.count == 1 for incident in case)
        first, last = speech.at(case.first.began), speech.at(case.last.completed)
        ends = f"from {first} to {last}" if listed else f"the first at {first}"
        text += f" ({times(case.count)} in all, {ends})"
    if order.parent(case) is None:
        text += _story(case, order, speech)
    return _as_sentence(text)


def _as_sentence(text: str) -> str:
    first = text.split(" ", 1)[0]
    return f"{text[:1].upper() if first in _OPENERS else text[:1]}{text[1:]}."


def _story(root: FindingGroup, order: _FindingOrder, speech: Speech) -> str:
    """Tell what came of a root: the first few steps, then in sum."""
    text, time, told = "", root.shown.completed, 0
    for case in order.first_consequences(root):
        clause = None if case.shown.then is None else case.shown.then(speech, case.shown.completed - time)
        if clause is None or told == _MAX_NAMED_STEPS:
            break
        text, time, told = f"{text}; {clause}", case.shown.completed, told + 1
    family = list(order.with_consequences(root))
    if len(family) - 1 > told or any(case.count > 1 for case in family[1:]):
        if order.explains_the_rest(root):
            return f"{text}; everything after that is a consequence"
        first, last = order.number(family[1]), order.number(family[-1])
        between = "and" if last == first + 1 else "to"
        text += (
            f"; finding {first} follows" if first == last else f"; findings {first} {between} {last} follow"
        )
        text += " from it"
    return text


def _frames(group: FindingGroup) -> tuple[int, ...]:
    """Return the frames of the incident that is told and the ends of the first and the last."""
    frames = list(group.shown.frames)
    if len(frames) > MAX_FRAMES_NAMED:
        frames = [*frames[: MAX_FRAMES_NAMED // 2], *frames[-MAX_FRAMES_NAMED // 2 :]]
    if group.count > 1:
        frames += [*group.first.frames[:1], *group.last.frames[-1:]]
    return tuple(sorted(set(frames)))
