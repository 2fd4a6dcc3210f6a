"""Types that describe why a controller refused a call."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place
from bcapscope.analysis.rules.rule_table import DiagnosisRule
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Moment
from bcapscope.traffic.call import Call


class RefusalReason(NamedTuple):
    """What the traffic shows about the reason for a refusal.

    Attributes:
        text: Value of `reason` in the message `finding.refused.because`; None if no reason is known.
        fact: Message instead of `finding.refused` or `finding.refused.because`; None for one of these two.
        clause: Message instead of `clause.refused`; None for `clause.refused`.
    """

    text: Message | None = None
    fact: Message | None = None
    clause: Message | None = None
    explaining_calls: tuple[int, ...] = ()
    evidence_call: Call | None = None
    group_key: str = ""
    advice: Message | None = None


NO_REASON = RefusalReason()
"""The reason for the refusal is unknown: the capture shows only the result code."""

ExplainRefusal: TypeAlias = Callable[[Call, ClientState], "RefusalReason | None"]


def reason_from_call(id: str, earlier: Call, **places: PlaceValue) -> RefusalReason:
    """Return the reason for a refusal that an earlier call explains. `id` names the message of the reason."""
    text = Message(id, call=call_place(earlier), at=Moment(earlier.request.time), **places)
    return RefusalReason(text, explaining_calls=(earlier.number,), evidence_call=earlier)


def reason_from_failure(topic: str, failed: Call, **places: PlaceValue) -> RefusalReason:
    return reason_from_call(f"reason.{topic}.{failure_case(failed)}", failed, **places)


def failure_case(failed: Call) -> str:
    return "unanswered" if failed.reply is None else "refused"


class Refusal(NamedTuple):
    """One kind of refusal, and the rule that reports it.

    Attributes:
        codes: Result codes to which this kind of refusal applies; empty for all codes.
        explain: Function that returns the reason why a call was refused; None if the call is not a refusal of
            this kind.
    """

    rule: DiagnosisRule
    codes: Collection[int]
    explain: ExplainRefusal = lambda call, client: NO_REASON
