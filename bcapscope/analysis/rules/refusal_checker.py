"""Report each refused call with the first rule that applies to the call."""

from __future__ import annotations

from bcapscope.analysis.client_state import MOTION_COMMANDS, MOTION_FUNCTIONS, ClientState
from bcapscope.analysis.finding_places import call_name_place, call_places, code_place
from bcapscope.analysis.rules import (
    error_rules,
    limit_rules,
    object_rules,
    pacing_rules,
    preparation_rules,
    request_rules,
    session_rules,
    slave_mode_rules,
)
from bcapscope.analysis.rules.rule_checker import CallHealth, Refusal, RefusalReason, RobotImpact, RuleChecker
from bcapscope.messages import Message
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, ends_slave_mode, rc7_digits_guessed
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind

REFUSALS: tuple[Refusal, ...] = (
    *session_rules.REFUSALS,
    *object_rules.REFUSALS,
    *slave_mode_rules.REFUSALS,
    *pacing_rules.REFUSALS,
    *limit_rules.REFUSALS,
    *preparation_rules.REFUSALS,
    *request_rules.REFUSALS,
    *error_rules.REFUSALS,
)
"""All kinds of refusal, specific kinds first. The last kind matches every refused call."""

_NEEDED_OBJECTS = (ObjectClass.SERVICE, ObjectClass.CONTROLLER, ObjectClass.ROBOT)
_PREPARATIONS = frozenset(
    (
        *("takearm", "motor", "robslave", "slvchangemode", "slvmove", "slvsendformat", "slvrecvformat"),
        *("clearerror", "manualreset", "manualresetpreparation", "motionpreparation"),
    )
)
"""Results of `ClientState.equivalent_command` for calls that prepare a motion."""


class RefusalChecker(RuleChecker):
    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return health is CallHealth.REFUSED

    def on_call(self, call: Call, client: ClientState) -> None:
        code = call.hresult
        assert code is not None
        for rule, codes, explain in REFUSALS:
            why = explain(call, client) if not codes or code in codes else None
            if why is None:
                continue
            self.report_call(
                rule,
                call,
                _marked_guess(why.fact or _usual_sentence(call, code, why), code),
                why.clause or Message("clause.refused", call=call_name_place(call), code=code_place(code)),
                evidence_call=why.evidence_call,
                explaining_calls=why.explaining_calls or _error_to_clear(call, client),
                group_key=why.group_key,
                advice=why.advice,
                impact=_impact(rule, call, client),
            )
            return


def _impact(rule: str, call: Call, client: ClientState) -> RobotImpact:
    code, command = call.hresult or 0, call.kind.folded_command
    moves = call.kind.function_id in MOTION_FUNCTIONS or command in MOTION_COMMANDS
    if rule == "refused-in-slave-mode":
        return RobotImpact.STOPPED
    if command == "slvmove" and client.recent_set_points and code != E_SLAVE_OVERFLOW:
        return RobotImpact.STOPPED
    if ends_slave_mode(code) and (moves or client.recent_set_points):
        return RobotImpact.STOPPED
    function = FUNCTIONS.get(call.kind.function_id)
    opens = function is not None and function.creates in _NEEDED_OBJECTS
    prepares = client.equivalent_command(call) in _PREPARATIONS
    return RobotImpact.PREVENTED if moves or opens or prepares else RobotImpact.NONE


def _error_to_clear(call: Call, client: ClientState) -> tuple[int, ...]:
    """If `call` is a ClearError, return the number of the call that reported the error to clear. Return () if
    `call` is another command, or if no error is known.
    """
    error = client.uncleared_error
    return (error.number,) if error is not None and call.kind.folded_command == "clearerror" else ()


def _marked_guess(fact: Message, code: int) -> Message:
    """Return `fact`, with a remark if the meaning of `code` is only a guess (see `rc7_digits_guessed`)."""
    digits = rc7_digits_guessed(code)
    return fact if digits is None else Message("finding.rc7-guess", fact=fact, digits=digits)


def _usual_sentence(call: Call, code: int, why: RefusalReason) -> Message:
    usual = {**call_places(call), "code": code_place(code)}
    if why.text is None:
        return Message("finding.refused", **usual)
    return Message("finding.refused.because", **usual, reason=why.text)
