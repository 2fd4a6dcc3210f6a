"""Refused calls: each is assigned to one rule."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.rules.rule_checker import DiagnosisRule
from bcapscope.messages import Message
from bcapscope.traffic.call import Call


class RefusalReason(NamedTuple):
    """What is known about the reason of a refusal.

    Attributes:
        text: What explains it, for the place `reason` of the usual sentence; None for nothing.
        fact: The whole sentence, if the usual one does not fit.
        clause: The clause for a consequence, if the usual one does not fit.
    """

    text: Message | None = None
    fact: Message | None = None
    clause: Message | None = None
    explaining_calls: tuple[int, ...] = ()
    evidence_call: Call | None = None
    group_key: str = ""
    advice: Message | None = None


NO_REASON = RefusalReason()
"""Only the result code is known."""

ExplainRefusal: TypeAlias = Callable[[Call, ClientState], "RefusalReason | None"]


class Refusal(NamedTuple):
    """One kind of refusal.

    Attributes:
        codes: Result codes that it covers; empty for any.
        explain: Returns the reason; None if this refusal does not apply to the call.
    """

    rule: DiagnosisRule
    codes: Collection[int]
    explain: ExplainRefusal = lambda call, client: NO_REASON
