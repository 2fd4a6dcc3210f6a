"""Rules about calls that a proxy disturbed and recorded."""

from __future__ import annotations

from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_places
from bcapscope.analysis.rules.rule_checker import Occurrence, RuleChecker
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Duration, Moment, WireText
from bcapscope.traffic.call import Call
from bcapscope.traffic.joining.joined_observation import JoinedObservation

_HELD_NS = 1_000_000
"""Shortest delay by the proxy, in ns, that a finding mentions. Without faults, holds and scripts, the proxy
usually delays a frame by far less than 1 ms.
"""


class ProxyChecker(RuleChecker):
    def on_call(self, call: Call, client: ClientState) -> None:
        noted: dict[str, list[JoinedObservation]] = {}
        for seen in call.joined_frames:
            if seen.note:
                noted.setdefault(seen.note, []).append(seen)
        for note, frames in noted.items():
            self._report(call, note, frames)

    def _report(self, call: Call, note: str, frames: list[JoinedObservation]) -> None:
        places = {**call_places(call), "at": Moment(frames[0].time)}
        rule, separator, what = note.partition(": ")
        if separator:
            fact = Message("finding.injected-fault", **places, rule=WireText(rule), what=WireText(what))
            clause = Message("clause.injected-fault", rule=WireText(rule))
        else:
            fact, clause = Message("finding.injected-fault.note", **places, what=WireText(note)), None
        self.report_occurrence(
            Occurrence(
                "injected-fault",
                call.request.time,
                frames[-1].time,
                call.conversation,
                tuple(seen.number for seen in frames),
                fact,
                clause,
                call=call.number,
                group_key=note,
                count=len(frames),
            )
        )


def with_place(call: Call, fact: Message) -> Message:
    """Add to `fact` the place where frames of the call were lost or held, if this place is known."""
    lost = call.lost_between
    if lost:
        case = "in-proxy" if lost[0].is_relayed else "between"
        return Message(f"finding.lost-{case}", fact=fact, frames=Count(len(lost), "frame"))
    if _reached_controller_side(call):
        return Message("finding.reached-controller-side", fact=fact)
    held = max((seen.held_by_proxy for seen in call.joined_frames), default=0)
    return Message("finding.held-in-proxy", fact=fact, held=Duration(held)) if held >= _HELD_NS else fact


def advice_by_place(call: Call) -> Message | None:
    """Return the advice for a call that was captured at two places; None for the rule's usual advice."""
    lost = call.lost_between
    if lost:
        return Message("rule.advice.in-proxy" if lost[0].is_relayed else "rule.advice.between")
    if _reached_controller_side(call):
        return Message("rule.advice.reached-controller-side")
    held = any(seen.held_by_proxy >= _HELD_NS for seen in call.joined_frames)
    return Message("rule.advice.in-proxy") if held else None


def _reached_controller_side(call: Call) -> bool:
    return call.reply is None and any(
        seen.is_request and seen.at_controller is not None for seen in call.joined_frames
    )
