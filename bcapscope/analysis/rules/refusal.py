"""Types that describe why a controller refused a call."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.rules.rule_checker import DiagnosisRule
from bcapscope.messages import Message
from bcapscope.traffic.call import Call


class RefusalReason(NamedTuple):
    """What the traffic shows about the reason for a refusal.

    Attributes:
        text: Clause that explains the refusal, as `reason` in the sentence `finding.refused.because`; None if
            no reason is known.
        fact: Sentence that replaces `finding.refused` and `finding.refused.because`; None to use these.
        clause: Clause that replaces `clause.refused` when the refusal is a consequence; None to use that
            clause.
    """

    text: Message | None = None
    fact: Message | None = None
    clause: Message | None = None
    explaining_calls: tuple[int, ...] = ()
    evidence_call: Call | None = None
    group_key: str = ""
    advice: Message | None = None


NO_REASON = RefusalReason()
"""The reason is unknown: only the result code was captured."""

ExplainRefusal: TypeAlias = Callable[[Call, ClientState], "RefusalReason | None"]


class Refusal(NamedTuple):
    """One kind of refusal, and the rule that reports it.

    Attributes:
        codes: Result codes to which this kind of refusal applies; empty for all codes.
        explain: Returns the reason for a refused call; None if this kind of refusal does not apply.
    """

    rule: DiagnosisRule
    codes: Collection[int]
    explain: ExplainRefusal = lambda call, client: NO_REASON
