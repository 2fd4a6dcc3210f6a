"""Refused calls: each is assigned to one rule."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.rules.rule_checker import DiagnosisRule
from bcapscope.analysis.speech import Speech, called, name_of, result_text, span
from bcapscope.protocol.tables.hresult import describe_hresult
from bcapscope.traffic.call import Call


class RefusalReason(NamedTuple):
    """What is known about the reason of a refusal.

    Attributes:
        text: Returns text to add to the sentence after a colon; None for nothing.
        say: Returns the whole sentence, if the usual one does not fit.
        then: Returns the clause for the sentence of the cause, if the usual one does not fit.
        explaining_calls: Numbers of calls that explain the refusal.
        evidence_call: Call whose frames help to prove it.
        group_key: Separates findings of one rule.
        advice: Advice for this case.
    """

    text: Callable[[Speech], str] | None = None
    say: Callable[[Speech], str] | None = None
    then: Callable[[Speech, int], str] | None = None
    explaining_calls: tuple[int, ...] = ()
    evidence_call: Call | None = None
    group_key: str = ""
    advice: str = ""


NO_REASON = RefusalReason()
"""Only the result code is known."""

ExplainRefusal: TypeAlias = Callable[[Call, ClientState, ClientRegistry], "RefusalReason | None"]


class Refusal(NamedTuple):
    """One kind of refusal.

    Attributes:
        rule: Rule that reports it.
        codes: Result codes that it covers; empty for any.
        explain: Returns the reason; None if this refusal does not apply to the call.
    """

    rule: DiagnosisRule
    codes: frozenset[int]
    explain: ExplainRefusal


def make_refusal(rule: DiagnosisRule, codes: Iterable[int], explain: ExplainRefusal | None = None) -> Refusal:
    """Return a `Refusal`. Without `explain` the sentence shows only call and result code."""
    return Refusal(rule, frozenset(codes), explain or (lambda call, client, clients: NO_REASON))


def fixed_reason(text: str) -> RefusalReason:
    """Return a reason with a constant text."""
    return RefusalReason(lambda speech: text)


def usual_sentence(call: Call, code: int, why: RefusalReason) -> Callable[[Speech], str]:
    """Return a function that builds the usual sentence about a refusal."""

    def say(speech: Speech) -> str:
        who, when = speech.client(call.conversation), speech.at(call.request.time)
        text = f"at {when} {called(call)} of {who} was refused with {result_text(code)}"
        return f"{text}: {why.text(speech)}" if why.text is not None else text

    return say


def usual_clause(call: Call, code: int) -> Callable[[Speech, int], str]:
    """Return a function that builds the usual clause about a refusal as a consequence."""

    def then(speech: Speech, after: int) -> str:
        when = f" {span(after)} later" if after > 0 else ""
        return f"{name_of(call)} was refused{when} (0x{code:08X}, {describe_hresult(code).text})"

    return then
