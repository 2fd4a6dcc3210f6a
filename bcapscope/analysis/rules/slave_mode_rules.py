"""Rules about slave mode that is entered wrongly, ends unnoticed, or is disturbed by another client."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.call_arguments import argument
from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_name_place, call_place, client_place
from bcapscope.analysis.rules.rule_checker import (
    MS,
    Occurrence,
    Refusal,
    RefusalReason,
    RobotImpact,
    RuleChecker,
    failure_case,
    reason_from_call,
)
from bcapscope.analysis.slave.slave_session import CallFact, ExitReason, FrameTime, SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import CallPlace, HexNumber, Moment
from bcapscope.protocol.codec.variant import integer_value
from bcapscope.protocol.tables.call_effect import CallEffect, function_effect
from bcapscope.protocol.tables.command_catalogue import find_command
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import E_REFUSED_IN_SLAVE_MODE, with_rc7_forms
from bcapscope.traffic.call import Call
from bcapscope.traffic.slave_mode_tracker import SLAVE_MODE_OFF_CODES

_NOT_ALLOWED = with_rc7_forms((E_REFUSED_IN_SLAVE_MODE, 0x8120174E, 0x81500177))
_SUSPECT_WITHIN_NS = 200 * MS


class SlaveModeChecker(RuleChecker):
    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        exit_ = session.exit
        if exit_.reason is ExitReason.OTHER_CLIENT and exit_.by is not None:
            yield _ended_by_other(session, exit_.by)
        elif exit_.reason is ExitReason.FOUND_OFF and session.last_set_point is not None:
            yield _lost_unseen(session, session.last_set_point)


def _ended_by_other(session: SlaveSession, by: CallFact) -> Occurrence:
    other, call = str(by.client), _call_name_place(by)
    fact = Message(
        "finding.slave-mode-ended-by-other",
        other=other,
        call=call,
        at=Moment(by.time),
        client=client_place(session.conversation),
    )
    clause = Message("clause.slave-mode-ended-by-other", other=other, call=call)
    frames = tuple(frame for frame in (by.request_frame, by.reply_frame) if frame is not None)
    return Occurrence(
        "slave-mode-ended-by-other",
        by.time,
        session.exit.time,
        session.conversation,
        frames,
        fact,
        clause,
        call=by.call,
        impact=RobotImpact.STOPPED,
    )


def _lost_unseen(session: SlaveSession, last: FrameTime) -> Occurrence:
    exit_ = session.exit
    suspects = [
        call
        for call in session.other_calls
        if call.client != session.conversation.client
        and last.time - _SUSPECT_WITHIN_NS <= call.time < exit_.time
        and not _is_harmless_call(call)
    ]
    places: dict[str, PlaceValue] = {"client": client_place(session.conversation), "since": Moment(last.time)}
    fact = Message("finding.slave-mode-lost-unseen", **places)
    if suspects:
        by = suspects[-1]
        places |= {"other": str(by.client), "call": _call_name_place(by), "at": Moment(by.time)}
        fact = Message("finding.slave-mode-lost-unseen.suspect", **places)
    clause = Message("clause.slave-mode-lost-unseen")
    frames = (last.frame, *(call.request_frame for call in suspects[-1:]), *exit_.frames[-1:])
    where, ended, impact = session.conversation, last.time + 1, RobotImpact.STOPPED
    return Occurrence("slave-mode-lost-unseen", last.time, ended, where, frames, fact, clause, impact=impact)


def _call_name_place(call: CallFact) -> CallPlace:
    return CallPlace(call.command or function_name(call.function_id), None, call.call)


def _is_harmless_call(call: CallFact) -> bool:
    if call.command is None:
        return function_effect(call.function_id) < CallEffect.CHANGES
    known = find_command(call.function_id, call.command)
    return known is not None and (known.effect < CallEffect.CHANGES or known.in_slave_mode is True)


def _explain_outside(call: Call, client: ClientState) -> RefusalReason | None:
    ended, entered = client.mode_ended_by, client.mode_entered_by
    latest = client.latest_calls.get("slvchangemode")
    known = max((each.number for each in (ended, entered) if each is not None), default=0)
    if latest is not None and latest.number > known:
        return reason_from_call(f"reason.slave-mode.{failure_case(latest)}", latest)
    if entered is None and ended is None:
        unseen = client.mode_value is None and not client.session_start_seen
        return RefusalReason(Message(f"reason.slave-mode.{'never-on' if unseen else 'not-entered'}"))
    if ended is None or (entered is not None and entered.number > ended.number):
        return _explain_off_unseen(call, client)
    if ended.kind.folded_command == "slvchangemode":
        return RefusalReason(
            Message("reason.slave-mode.left", call=call_place(ended), at=Moment(ended.request.time)),
            evidence_call=ended,
        )
    return RefusalReason(
        Message("reason.slave-mode.error", call=call_place(ended)), explaining_calls=(ended.number,)
    )


def _explain_off_unseen(call: Call, client: ClientState) -> RefusalReason:
    ends = [each.mode_ended_by for each in client.other_clients()]
    others = [each for each in ends if each is not None and each.request.time <= call.request.time]
    return RefusalReason(
        Message("reason.slave-mode.off-by-others"), explaining_calls=tuple(each.number for each in others)
    )


def _explain_not_allowed(call: Call, client: ClientState) -> RefusalReason | None:
    owner = next((each for each in (*client.other_clients(), client) if _was_in_slave_mode(each, call)), None)
    name = call_name_place(call)
    places: dict[str, PlaceValue] = {
        "client": client_place(call.conversation),
        "call": name,
        "at": Moment(call.request.time),
        "code": HexNumber(call.hresult or 0),
    }
    case = ""
    if owner is client:
        case = ".own"
    elif owner is not None:
        case, places["owner"] = ".other", client_place(owner.conversation)
    return RefusalReason(
        fact=Message(f"finding.refused-in-slave-mode{case}", **places),
        clause=Message("clause.refused-in-slave-mode", call=name),
    )


def _was_in_slave_mode(client: ClientState, call: Call) -> bool:
    entered, ended = client.mode_entered_by, client.mode_ended_by
    if client.mode_value:
        return True
    return (
        entered is not None
        and ended is not None
        and entered.number < ended.number
        and ended.request.time >= call.request.time
    )


def _explain_mode_refused(call: Call, client: ClientState) -> RefusalReason | None:
    parameter = argument(call, 2)
    if call.kind.folded_command != "slvchangemode" or parameter is None:
        return None
    value = integer_value(parameter)
    if value is None:
        return RefusalReason(Message("reason.slave-mode.no-number"))
    return RefusalReason(Message("reason.slave-mode.value", mode=HexNumber(value, 3)))


REFUSALS: tuple[Refusal, ...] = (
    Refusal("slvmove-outside-slave-mode", SLAVE_MODE_OFF_CODES, _explain_outside),
    Refusal("refused-in-slave-mode", _NOT_ALLOWED, _explain_not_allowed),
    Refusal("slave-mode-refused", (0x80070057, 0x80020005, 0x80010003, 0x83500127), _explain_mode_refused),
)
