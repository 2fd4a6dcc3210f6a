"""Incidents are collected here, tied to what they follow from, and told as findings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.rules.rule import Incident, Rule
from bcapscope.analysis.speech import Speech, times

MOST_KEPT = 32
"""Incidents of one finding that are kept from the beginning, and as many from the end."""

MOST_FINDINGS = 16
"""Findings of one rule, where it tells several apart; what comes beyond joins the first."""

MOST_CALLS = 256
"""Calls whose incidents can be found by their number, the latest: what explains a call is not long ago. An
incident may hold all that is known of a stay in slave mode, some 20 kB."""

MOST_FRAMES = 16
"""Frames that a finding names."""

_MOST_STEPS = 3
"""Consequences that the sentence of a root tells one by one."""

_OPENERS = frozenset(("the", "your", "client", "a", "at", "that", "after", "frame", "another", "slave"))
"""Words of ours that a sentence may begin with; names from the wire stay as they are."""

_RANK = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}


class Case:
    """All incidents that become one finding.

    Attributes:
        rule: of all.
        asked: whether it is to be told for itself, as its incidents are.
        count: how many there were.
        chosen: the one that is told; set by `Casebook.findings`.
    """

    def __init__(self, rule: Rule, asked: bool) -> None:
        self.rule = rule
        self.asked = asked
        self.count = 0
        self._first: list[Incident] = []
        self._last: deque[Incident] = deque(maxlen=MOST_KEPT)
        self._held: list[Incident] = []
        self.chosen: Incident

    def add(self, incident: Incident) -> None:
        """Take one more."""
        self.count += incident.count
        (self._first if len(self._first) < MOST_KEPT else self._last).append(incident)

    def hold(self, incident: Incident) -> None:
        """Keep one that had consequences, whatever comes after it."""
        if len(self._held) < MOST_KEPT and incident not in self._held:
            self._held.append(incident)

    def __iter__(self) -> Iterator[Incident]:
        """Yield those that are kept, each once."""
        return iter(dict.fromkeys((*self._first, *self._held, *self._last)))

    @property
    def first(self) -> Incident:
        """The one that began first, of those kept."""
        return min(self, key=lambda each: each.began)

    @property
    def last(self) -> Incident:
        """The one that was over last, of those kept."""
        return max(self, key=lambda each: each.time)


class Casebook:
    """Takes incidents in the order in which rules find them, which is not always that of their times."""

    def __init__(self) -> None:
        self._cases: dict[tuple[str, bool, str], Case] = {}
        self._by_rule: dict[str, list[Case]] = {}
        self._by_call: dict[int, list[Incident]] = {}
        self._new: list[Case] = []

    def report(self, incident: Incident) -> None:
        """Take an incident in."""
        rule = incident.rule
        case = self._cases.get((rule.id, incident.asked, incident.key)) or self._open(incident)
        case.add(incident)
        if incident.call:
            self._by_call.setdefault(incident.call, []).append(incident)
            if len(self._by_call) > MOST_CALLS:
                del self._by_call[next(iter(self._by_call))]
        if case.count <= MOST_KEPT:
            self._link(incident)

    def _open(self, incident: Incident) -> Case:
        rule, asked = incident.rule, incident.asked
        cases = self._by_rule.setdefault(rule.id, [])
        alike = [case for case in cases if case.asked is asked]
        if len(alike) >= MOST_FINDINGS:
            return alike[0]
        case = self._cases[rule.id, asked, incident.key] = Case(rule, asked)
        cases.append(case)
        self._new.append(case)
        return case

    def _link(self, incident: Incident) -> None:
        """Look for what an incident follows from: the calls that it names, else what came last before it.

        Called again when all is known: what was found last may have come before, and fits better.
        """
        known, incident.cause = incident.cause, None
        likely = incident.rule.follows
        named = [
            each
            for number in incident.because
            for each in self._by_call.get(number, ())
            if each.rule.severity is not Severity.NOTE or each.rule.id in likely
        ]
        causes = [each for each in named if _precedes(each, incident)]
        if not causes:
            found = list(self._candidates(incident)) + ([] if known is None else [known])
            causes = [each for each in found if _precedes(each, incident)]
        if causes:
            incident.cause = max(causes, key=lambda each: (each.began, -_place(each.rule.id, likely)))
            self._case_of(incident.cause).hold(incident.cause)

    def _case_of(self, incident: Incident) -> Case:
        known = self._cases.get((incident.rule.id, incident.asked, incident.key))
        return known or next(case for case in self._by_rule[incident.rule.id] if case.asked is incident.asked)

    def _candidates(self, incident: Incident) -> Iterator[Incident]:
        earliest, host = incident.began - incident.rule.reach, incident.conversation.server.host
        for rule_id in incident.rule.follows:
            for case in self._by_rule.get(rule_id, ()):
                for each in case:
                    if each.time >= earliest and each.conversation.server.host == host:
                        yield each

    def news(self, speech: Speech) -> tuple[Finding, ...]:
        """Tell the cases that are new since the last time; what follows from what shows later."""
        new, self._new = self._new, []
        return tuple(
            Finding(
                rule=case.rule.id,
                severity=case.rule.severity,
                sentence=_as_sentence(case.first.say(speech)),
                frames=case.first.frames[:MOST_FRAMES],
                consequence_of=None,
                advice=case.first.advice or case.rule.advice,
                source=case.rule.source,
            )
            for case in new
            if case.asked
        )

    def findings(self, speech: Speech) -> tuple[Finding, ...]:
        """Tell all cases that are asked for and what these follow from.

        Each root comes with its consequences behind it, the gravest and earliest root first.
        """
        cases = list(self._cases.values())
        for case in cases:
            for incident in case:
                self._link(incident)
        self._choose(cases)
        order = _Order(_asked(cases))
        return tuple(
            Finding(
                rule=case.rule.id,
                severity=case.rule.severity,
                sentence=_sentence(case, order, speech),
                frames=_frames(case),
                consequence_of=order.parent(case),
                advice=case.chosen.advice or case.rule.advice,
                source=case.rule.source,
            )
            for case in order.cases
        )

    def _choose(self, cases: Iterable[Case]) -> None:
        """Choose the incident to be told: the first that has consequences, else the first."""
        followed = {id(incident.cause) for case in cases for incident in case if incident.cause is not None}
        for case in cases:
            case.chosen = min(case, key=lambda each: (id(each) not in followed, each.began, each.time))


def _place(rule_id: str, likely: tuple[str, ...]) -> int:
    return likely.index(rule_id) if rule_id in likely else len(likely)


def _precedes(cause: Incident, effect: Incident) -> bool:
    """Tell whether one can be the cause of the other."""
    return cause is not effect and cause.began <= effect.time and not _leads_to(cause, effect)


def _leads_to(start: Incident, goal: Incident) -> bool:
    each: Incident | None = start
    while each is not None:
        if each is goal:
            return True
        each = each.cause
    return False


def _parents(cases: list[Case]) -> dict[int, Case]:
    """Map each case to that of its chosen incident's cause, where this leads back to no case twice."""
    home = {id(incident): case for case in cases for incident in case}
    parents: dict[int, Case] = {}
    for case in sorted(cases, key=lambda each: each.chosen.began):
        cause = case.chosen.cause
        parent = home.get(id(cause)) if cause is not None else None
        above = parent
        while above is not None and above is not case:
            above = parents.get(id(above))
        if parent is not None and above is None:
            parents[id(case)] = parent
    return parents


def _asked(cases: list[Case]) -> list[Case]:
    """Leave off what is not asked for and leads to nothing that is."""
    parents = _parents(cases)
    kept: set[int] = set()
    for case in cases:
        each: Case | None = case if case.asked else None
        while each is not None and id(each) not in kept:
            kept.add(id(each))
            each = parents.get(id(each))
    return [case for case in cases if id(case) in kept]


class _Order:
    """The cases in the order in which they are told, and which follow from which."""

    def __init__(self, cases: list[Case]) -> None:
        parents = _parents(cases)
        self._children: dict[int, list[Case]] = {}
        for case in sorted(cases, key=lambda each: (each.chosen.began, _RANK[each.rule.severity])):
            parent = parents.get(id(case))
            self._children.setdefault(0 if parent is None else id(parent), []).append(case)
        roots = sorted(self._children.get(0, ()), key=self._gravity)
        self.cases = [case for root in roots for case in self.family(root)]
        self._numbers = {id(case): number for number, case in enumerate(self.cases, 1)}
        self._parents = parents

    def number(self, case: Case) -> int:
        return self._numbers[id(case)]

    def parent(self, case: Case) -> int | None:
        """Return the number of what a case follows from."""
        parent = self._parents.get(id(case))
        return None if parent is None else self.number(parent)

    def family(self, case: Case) -> Iterator[Case]:
        """Yield a case and all that follows from it."""
        yield case
        for child in self._children.get(id(case), ()):
            yield from self.family(child)

    def line(self, case: Case) -> Iterator[Case]:
        """Yield what followed first from a case, what followed first from that, and so on."""
        while self._children.get(id(case)):
            case = self._children[id(case)][0]
            yield case

    def _gravity(self, case: Case) -> int:
        return min(_RANK[each.rule.severity] for each in self.family(case))

    def explains_the_rest(self, case: Case) -> bool:
        """Tell whether all that went wrong later follows from this case."""
        family = {id(each) for each in self.family(case)}
        return all(
            id(each) in family
            or each.rule.severity is Severity.NOTE
            or max(incident.began for incident in each) <= case.chosen.time
            for each in self.cases
        )


def _sentence(case: Case, order: _Order, speech: Speech) -> str:
    chosen = case.chosen
    text = chosen.say(speech)
    if case.count > 1:
        listed = all(incident.count == 1 for incident in case)
        first, last = speech.at(case.first.began), speech.at(case.last.time)
        ends = f"from {first} to {last}" if listed else f"the first at {first}"
        text += f" ({times(case.count)} in all, {ends})"
    if order.parent(case) is None:
        text += _story(case, order, speech)
    return _as_sentence(text)


def _as_sentence(text: str) -> str:
    first = text.split(" ", 1)[0]
    return f"{text[:1].upper() if first in _OPENERS else text[:1]}{text[1:]}."


def _story(root: Case, order: _Order, speech: Speech) -> str:
    """Tell what came of a root: the first few steps, then in sum."""
    text, time, told = "", root.chosen.time, 0
    for case in order.line(root):
        clause = None if case.chosen.then is None else case.chosen.then(speech, case.chosen.time - time)
        if clause is None or told == _MOST_STEPS:
            break
        text, time, told = f"{text}; {clause}", case.chosen.time, told + 1
    family = list(order.family(root))
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


def _frames(case: Case) -> tuple[int, ...]:
    """Return the frames of the incident that is told and the ends of the first and the last."""
    frames = list(case.chosen.frames)
    if len(frames) > MOST_FRAMES:
        frames = [*frames[: MOST_FRAMES // 2], *frames[-MOST_FRAMES // 2 :]]
    if case.count > 1:
        frames += [*case.first.frames[:1], *case.last.frames[-1:]]
    return tuple(sorted(set(frames)))
