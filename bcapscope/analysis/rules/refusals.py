"""Refused calls, told by the first of many rules that fits."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients
from bcapscope.analysis.rules import (
    errors,
    limits,
    objects,
    pacing,
    preparation,
    requests,
    session,
    slavemode,
)
from bcapscope.analysis.rules.refusal import Refusal, usual_clause, usual_sentence
from bcapscope.analysis.rules.rule import Kind, Report, Watcher
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.question import Question

REFUSALS: tuple[Refusal, ...] = (
    *session.REFUSALS,
    *objects.REFUSALS,
    *slavemode.REFUSALS,
    *pacing.REFUSALS,
    *limits.REFUSALS,
    *preparation.REFUSALS,
    *requests.REFUSALS,
    *errors.REFUSALS,
)
"""All ways to be refused, the particular ones before the general; the last fits any."""


class Refusals(Watcher):
    """Gives each refused call to the one rule that tells it."""

    rules = tuple(dict.fromkeys(each.rule for each in REFUSALS))

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._by_code: dict[int, tuple[Refusal, ...]] = {}

    def heeds(self, question: Question, kind: Kind) -> bool:
        return kind is Kind.REFUSED

    def call(self, call: Exchange, client: Client) -> None:
        code = call.hresult
        assert code is not None
        for rule, _, explain in self._about(code):
            why = explain(call, client, self.clients)
            if why is None:
                continue
            say = why.say or usual_sentence(call, code, why)
            then = why.then or usual_clause(call, code)
            self.tell(
                rule, call, say, then, before=why.before, because=why.because, key=why.key, advice=why.advice
            )
            return

    def _about(self, code: int) -> tuple[Refusal, ...]:
        about = self._by_code.get(code)
        if about is None:
            if len(self._by_code) >= 4096:
                self._by_code.clear()
            about = self._by_code[code] = tuple(
                each for each in REFUSALS if not each.codes or code in each.codes
            )
        return about
