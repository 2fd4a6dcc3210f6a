"""Refused calls: which rule tells a refusal, decided once for each."""

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
        text: adds to the sentence, after a colon; None for nothing.
        say: the whole sentence, where the usual one will not do.
        then: the clause for the sentence of its cause, where the usual one will not do.
        explaining_calls: numbers of calls that explain it.
        evidence_call: a call whose frames help to prove it.
        group_key: tells findings of one rule apart.
        advice: for this case.
    """

    text: Callable[[Speech], str] | None = None
    say: Callable[[Speech], str] | None = None
    then: Callable[[Speech, int], str] | None = None
    explaining_calls: tuple[int, ...] = ()
    evidence_call: Call | None = None
    group_key: str = ""
    advice: str = ""


NO_REASON = RefusalReason()
"""Nothing is known but the code."""

ExplainRefusal: TypeAlias = Callable[[Call, ClientState, ClientRegistry], "RefusalReason | None"]


class Refusal(NamedTuple):
    """One way to be refused.

    Attributes:
        rule: that tells it.
        codes: results that it is about; empty for any.
        explain: looks for the reason; None where it is not about this call after all.
    """

    rule: DiagnosisRule
    codes: frozenset[int]
    explain: ExplainRefusal


def make_refusal(rule: DiagnosisRule, codes: Iterable[int], explain: ExplainRefusal | None = None) -> Refusal:
    """Make a `Refusal`; without `explain`, code and call say it all."""
    return Refusal(rule, frozenset(codes), explain or (lambda call, client, clients: NO_REASON))


def fixed_reason(text: str) -> RefusalReason:
    """Make a reason of one text."""
    return RefusalReason(lambda speech: text)


def usual_sentence(call: Call, code: int, why: RefusalReason) -> Callable[[Speech], str]:
    """Return the sentence of a refusal."""

    def say(speech: Speech) -> str:
        who, when = speech.client(call.conversation), speech.at(call.request.time)
        text = f"at {when} {called(call)} of {who} was refused with {result_text(code)}"
        return f"{text}: {why.text(speech)}" if why.text is not None else text

    return say


def usual_clause(call: Call, code: int) -> Callable[[Speech, int], str]:
    """Return how a refusal is told as a consequence."""

    def then(speech: Speech, after: int) -> str:
        when = f" {span(after)} later" if after > 0 else ""
        return f"{name_of(call)} was refused{when} (0x{code:08X}, {describe_hresult(code).text})"

    return then
