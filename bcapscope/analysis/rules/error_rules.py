"""Rules about errors that a client does not clear or read, and about errors that no other rule covers."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.call_arguments import requested_motor_state
from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place, client_place
from bcapscope.analysis.rules.rule_checker import (
    CallHealth,
    ClientEnd,
    Occurrence,
    Refusal,
    RefusalReason,
    RuleChecker,
    failure_case,
    frame_numbers,
    last_frame_time,
    reason_from_call,
)
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, HexNumber, Moment
from bcapscope.protocol.guard import always_passes
from bcapscope.protocol.tables.call_effect import CallEffect, function_effect
from bcapscope.protocol.tables.command_catalogue import find_command
from bcapscope.protocol.tables.hresult import (
    E_ROBOTISBUSY,
    E_TIMEOUT,
    describe_hresult,
    is_failure,
    with_rc7_forms,
)
from bcapscope.protocol.tables.variables import SERVO_ON
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

ACTIVE_CODES = with_rc7_forms((0x81501025, 0x81201701, 0x81201749, 0x82501009))
"""Result codes with which a controller refuses a call because an error is active."""
_TIMEOUT_CODES = (E_TIMEOUT, 0x8150012D, 0x81500151, 0x82201F92, 0x82201694, 0x800706BE)


class _CallsAfterError:
    """Calls that a client made after an uncleared controller error, and that can change or move something.

    Attributes:
        clear_attempt: The first ClearError call that got no successful reply.
    """

    def __init__(self, failure: Call) -> None:
        self.error_call = failure
        self.count = 0
        self.first: Call | None = None
        self.clear_attempt: Call | None = None


class ErrorChecker(RuleChecker):
    by_client: dict[Conversation, _CallsAfterError]

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        name = call_kind.folded_command
        if name == "slvmove":
            return health is not CallHealth.SMOOTH
        if name:
            known = find_command(call_kind.function_id, name)
            return known is None or known.effect >= CallEffect.CHANGES
        return function_effect(call_kind.function_id) >= CallEffect.CHANGES

    def on_call(self, call: Call, client: ClientState) -> None:
        failure = client.uncleared_error
        if failure is None:
            return
        clears = call.kind.folded_command == "clearerror"
        if clears and call.reply is not None and not is_failure(call.reply.item.code):
            self.by_client.pop(call.conversation, None)
            if not any(each.error_was_read for each in (client, *client.other_clients())):
                self._report_unread(call, failure)
            return
        calls = self.by_client.get(call.conversation)
        if calls is None or calls.error_call is not failure:
            calls = self.by_client[call.conversation] = _CallsAfterError(failure)
        if clears:
            calls.clear_attempt = calls.clear_attempt or call
        elif call.request.time > failure.request.time and not _shuts_down(call, client):
            calls.count += 1
            calls.first = calls.first or call

    def end_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        calls, failure = self.by_client.get(end.client.conversation), end.client.uncleared_error
        first = None if calls is None else calls.first
        if calls is None or first is None or calls.error_call is not failure:
            return
        if not end.client.cleared_by_other(failure, first.request.time):
            yield _went_on(calls, first)

    def _report_unread(self, call: Call, failure: Call) -> None:
        fact = Message(
            "finding.cleared-unread",
            client=client_place(call.conversation),
            at=Moment(call.request.time),
            code=f"0x{failure.hresult or 0:08X}",
            failed=call_place(failure),
        )
        self.report_call(
            "cleared-unread", call, fact, evidence_call=failure, explaining_calls=(failure.number,)
        )


def _went_on(calls: _CallsAfterError, first: Call) -> Occurrence:
    failure, clear = calls.error_call, calls.clear_attempt
    places: dict[str, PlaceValue] = {
        "client": client_place(first.conversation),
        "failed": call_place(failure),
        "calls": Count(calls.count, "more-call"),
        "first": call_place(first),
    }
    case = ""
    if clear is not None:
        case, places["clear"] = ".unanswered", call_place(clear)
    if clear is not None and clear.hresult is not None:
        case, places["code"] = ".refused", HexNumber(clear.hresult)
    return Occurrence(
        "went-on-after-error",
        first.request.time,
        last_frame_time(first),
        first.conversation,
        frame_numbers(failure, first),
        Message(f"finding.went-on-after-error{case}", **places),
        call=first.number,
        explaining_calls=(failure.number,),
    )


def _shuts_down(call: Call, client: ClientState) -> bool:
    if call.kind.folded_command == "givearm":
        return True
    target = "" if client.target_object is None else client.target_object.name
    switches_motor = call.kind.folded_command == "motor" or target.casefold() == SERVO_ON.casefold()
    if switches_motor and requested_motor_state(call) is False:
        return True
    return always_passes(call.kind.function_id, call.request.item.variants)


def _explain_not_cleared(call: Call, client: ClientState) -> RefusalReason | None:
    failure = client.uncleared_error
    if failure is None:
        errors = (other.uncleared_error for other in client.other_clients())
        return RefusalReason(explaining_calls=tuple(each.number for each in errors if each is not None))
    clear = client.latest_calls.get("clearerror")
    if clear is None or clear.number < failure.number:
        return reason_from_call("reason.not-cleared", failure)
    case = failure_case(clear)
    reason = reason_from_call(f"reason.not-cleared.{case}", failure, clear=call_place(clear))
    return reason._replace(explaining_calls=(clear.number, failure.number), evidence_call=clear)


def _explain_other(call: Call, client: ClientState) -> RefusalReason | None:
    code = call.hresult or 0
    known = describe_hresult(code)
    failure = client.uncleared_error
    because = (failure.number,) if failure is not None and known.level is not None else ()
    return RefusalReason(explaining_calls=because, group_key=f"{code:08X}", advice=advice_on_code(code))


def advice_on_code(code: int) -> Message | None:
    advice = describe_hresult(code).advice
    return None if advice is None else Message("advice.result", advice=advice)


REFUSALS: tuple[Refusal, ...] = (
    Refusal("error-not-cleared", ACTIVE_CODES, _explain_not_cleared),
    Refusal("controller-timeout", _TIMEOUT_CODES),
    Refusal("robot-busy", (E_ROBOTISBUSY,)),
    Refusal("controller-error", (), _explain_other),
)
