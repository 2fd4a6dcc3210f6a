"""Rules about what a motion needs, such as the arm, the motor, standstill or the program RobSlave."""

from __future__ import annotations

from bcapscope.analysis.call_arguments import argument, gets_robslave, requested_motor_state
from bcapscope.analysis.client_state import MOTION_FUNCTIONS, ClientState
from bcapscope.analysis.finding_places import call_name_place, call_place, client_place
from bcapscope.analysis.rules.error_rules import ACTIVE_CODES
from bcapscope.analysis.rules.rule_checker import (
    MS,
    NO_REASON,
    SECOND,
    CallHealth,
    Refusal,
    RefusalReason,
    RuleChecker,
    failure_case,
    reason_from_call,
)
from bcapscope.messages import Message
from bcapscope.messages.places import ClientPlace, Duration, HexNumber, Moment, WireText
from bcapscope.protocol.codec.variant import Variant, integer_value
from bcapscope.protocol.guard import request_effect
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.enumerations import pass_motion_text
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import (
    E_ARM_NOT_TAKEN,
    describe_hresult,
    is_failure,
    is_rc7_code,
    with_rc7_forms,
)
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind

_MOVING_CODES = with_rc7_forms((0x600B, 0x8150100D, 0x81201744))
_STOP_CODES = with_rc7_forms(
    (0x8150101A, 0x8120170A, 0x83500178, 0x81501022, 0x8150101C, 0x8150101E, 0x81501078, 0x83501079)
)
_MODE_CODES = with_rc7_forms(
    (
        *range(0x81501012, 0x81501018),
        *(0x81501005, 0x81201705, 0x81201748, 0x81501007, 0x81501020, 0x81501021, 0x81501023),
        *(0x21E2, 0x21E3, 0x21E4, 0x21E5, 0x21E6, 0x21E7, 0x21F2, 0x21F3, 0x21FC),
    )
)
_TOKEN_CODES = with_rc7_forms(
    (*range(0x83501026, 0x8350102A), 0x80501043, 0x80501044, 0x2287, 0x2288, 0x2289)
)
_LICENCE_CODES = (0x80000901, 0x8000020C, 0x83500009, 0x83500126)
_RESET_CODES = (0x83500372, 0x81501069, 0x81501070)
_SWITCHES_OFF = 4
"""From this error level on, the controller switches the motor off (public list of controller errors)."""
_MOTOR_CODES = with_rc7_forms((0x81501003, 0x2006))
_ARM_CODES = with_rc7_forms((E_ARM_NOT_TAKEN, 0x21F7))

_WAITED_NS = 100 * MS
_JUST_BEFORE_NS = 5 * SECOND


class PreparationChecker(RuleChecker):
    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        command = call_kind.folded_command
        return command == "slvchangemode" or (health is not CallHealth.REFUSED and command != "slvmove")

    def on_call(self, call: Call, client: ClientState) -> None:
        if call.kind.folded_command == "slvchangemode" and _requests_mode(call):
            self._check_last_motion(call, client)
            self._check_type_read(call, client)
        elif client.last_motion is None and not client.type_was_read and _moves_robot(call):
            self._check_type_read(call, client)

    def _check_last_motion(self, call: Call, client: ClientState) -> None:
        motion = client.last_motion
        ending = "" if motion is None else _pass_of(motion)
        if motion is None or call.reply is None or ending.casefold() == "@e":
            return
        waited = call.reply.time - call.request.time
        code = call.reply.item.code
        just = call.request.time - motion.request.time < _JUST_BEFORE_NS
        if not just or not (code in _MOVING_CODES or (waited >= _WAITED_NS and not is_failure(code))):
            return
        fact = Message(
            f"finding.no-at-e.{'passes' if ending else 'without'}",
            call=call_place(call),
            motion=call_place(motion),
            waited=Duration(waited),
            **({"ending": WireText(ending)} if ending else {}),
        )
        began, completed = motion.request.time, call.request.time
        self.report_call("no-at-e", call, fact, evidence_call=motion, began=began, completed=completed)

    def _check_type_read(self, call: Call, client: ClientState) -> None:
        if client.last_motion is not None or not client.session_start_seen or _type_was_read(client):
            return
        client.type_was_read = True  # the finding is reported only once for each client
        who, what = client_place(call.conversation), call_name_place(call)
        self.report_call("type-not-checked", call, Message("finding.type-not-checked", client=who, call=what))


def _type_was_read(client: ClientState) -> bool:
    """Return whether the client, or another client on the same computer, read the robot's type."""
    host, clients = client.conversation.client.host, (client, *client.other_clients())
    return any(each.type_was_read for each in clients if each.conversation.client.host == host)


def _moves_robot(call: Call) -> bool:
    function_id, command = call.kind
    if function_id in MOTION_FUNCTIONS:
        return True
    if function_id != ID["Robot_Execute"] or command is None:
        return False
    return request_effect(function_id, call.request.item.variants) is CallEffect.MOVES


def _requests_mode(call: Call) -> bool:
    parameter = argument(call, 2)
    return parameter is not None and integer_value(parameter) != 0


def _pass_of(motion: Call) -> str:
    """Return the pass-motion option in the request of a motion, such as `@P` or `@0`; "" if there is none."""
    return _pass_in(argument(motion, 2)) or _pass_in(argument(motion, 3))


def _pass_in(variant: Variant | None) -> str:
    value = variant.value if variant is not None else None
    if isinstance(value, str):
        return next((word[:4] for word in value.split() if word.startswith("@")), "")
    if not isinstance(value, tuple):
        return ""
    if len(value) > 2 and isinstance(value[2], Variant) and isinstance(value[2].value, int):
        return pass_motion_text(value[2].value)
    return next((found for item in value[:8] if isinstance(item, Variant) and (found := _pass_in(item))), "")


def _explain_robslave(call: Call, client: ClientState) -> RefusalReason | None:
    code = call.hresult or 0
    if gets_robslave(call):
        return RefusalReason(Message("reason.robslave.no-program"))
    needs_program = call.kind.folded_command in ("slvchangemode", "slvmove")
    if not needs_program or code in ACTIVE_CODES:
        return None
    return _explain_task(client) if client.generation is Generation.RC7 or is_rc7_code(code) else None


def _explain_task(client: ClientState) -> RefusalReason | None:
    started = _latest_robslave_start(client)
    attempt = client.latest_calls.get("robslave")
    if attempt is not None and (started is None or started.request.time < attempt.request.time):
        return _unsuccessful(f"reason.robslave.{failure_case(attempt)}", attempt)
    if started is None:
        return _explain_never_started(client)
    stopped = client.uncleared_error or client.latest_error
    if stopped is None or stopped.number < started.number:
        return None
    return RefusalReason(
        Message("reason.robslave.stopped", start=call_place(started), stop=call_place(stopped)),
        explaining_calls=(stopped.number,),
        evidence_call=stopped,
    )


def _latest_robslave_start(client: ClientState) -> Call | None:
    """Return the latest Task_Start call, by any client, that started RobSlave."""
    starts = (each.robslave_start for each in (client, *client.other_clients()))
    found = [each for each in starts if each is not None]
    return max(found, key=lambda each: each.request.time, default=None)


def _explain_never_started(client: ClientState) -> RefusalReason | None:
    missing = client.robslave_not_found
    if missing is not None:
        return RefusalReason(
            Message("reason.robslave.not-found", call=call_place(missing)), explaining_calls=(missing.number,)
        )
    if not client.session_start_seen:
        return None
    return RefusalReason(Message("reason.robslave.not-started"))


def _explain_moving(call: Call, client: ClientState) -> RefusalReason | None:
    motion = client.last_motion
    if motion is None:
        return NO_REASON
    before, code = Duration(call.request.time - motion.request.time), HexNumber(call.hresult or 0)
    text = Message("reason.motion-before", motion=call_place(motion), before=before)
    clause = Message("clause.robot-still-moving", call=call_name_place(call), code=code)
    return RefusalReason(text, clause=clause, explaining_calls=(call.number,), evidence_call=motion)


def _explain_arm_taken(call: Call, client: ClientState) -> RefusalReason | None:
    for other in client.other_clients():
        taken = other.take_arm_call
        given_back = _unanswered(other, "givearm") is not None  # GiveArm without a reply may have worked
        if taken is not None and taken.request.time < call.request.time and not given_back:
            place, at = client_place(other.conversation), Moment(taken.request.time)
            return RefusalReason(Message("reason.arm.held", client=place, at=at), evidence_call=taken)
    if call.kind.folded_command != "takearm":
        return None
    return RefusalReason(Message("reason.arm.holder-unseen"))


def _unanswered(client: ClientState, command: str) -> Call | None:
    latest = client.latest_calls.get(command)
    return latest if latest is not None and latest.reply is None else None


def _explain_arm_missing(call: Call, client: ClientState) -> RefusalReason | None:
    taken, returned = client.take_arm_call, client.give_arm_call
    attempt = client.latest_calls.get("takearm")
    if taken is not None:
        unsure = _unanswered(client, "givearm")
        if unsure is not None:
            return reason_from_call("reason.arm.given-back.unanswered", unsure)
        reason = Message("reason.arm.lost", at=Moment(taken.request.time))
        return RefusalReason(reason, evidence_call=taken, explaining_calls=_error_since(taken, client))
    if attempt is not None and (returned is None or returned.number < attempt.number):
        return _unsuccessful(f"reason.arm.{failure_case(attempt)}", attempt)
    if returned is not None:
        return reason_from_call("reason.arm.given-back", returned)
    return RefusalReason(Message(f"reason.arm.not-{'taken' if client.session_start_seen else 'seen'}"))


def _error_since(call: Call, client: ClientState) -> tuple[int, ...]:
    error = client.latest_error
    return (error.number,) if error is not None and error.number > call.number else ()


def _unsuccessful(id: str, attempt: Call) -> RefusalReason:
    code = attempt.hresult
    return reason_from_call(id, attempt, **({} if code is None else {"code": HexNumber(code)}))


def _explain_motor(call: Call, client: ClientState) -> RefusalReason | None:
    motor, failure = client.motor_call, client.uncleared_error or client.latest_error
    attempt = client.latest_calls.get("motor")
    if attempt is not None and attempt is not motor and requested_motor_state(attempt) is not False:
        return _unsuccessful(f"reason.motor.{failure_case(attempt)}", attempt)
    if motor is not None and client.motor_on is False:
        return _motor_reason("switched-off", motor)
    by_other = _switched_off_by_other(call, client)
    if by_other is not None:
        return by_other
    if failure is not None and (motor is None or motor.request.time < failure.request.time):
        level = describe_hresult(failure.hresult or 0).level
        grave = level is not None and level >= _SWITCHES_OFF
        return RefusalReason(
            Message(f"reason.motor.error{'' if grave else '.perhaps'}", call=call_place(failure)),
            explaining_calls=(failure.number,) if grave else (),
        )
    if motor is None:
        return RefusalReason(Message("reason.motor.not-called"))
    return _motor_reason("unclear" if client.motor_on is None else "lost", motor)


def _switched_off_by_other(call: Call, client: ClientState) -> RefusalReason | None:
    own = client.motor_call
    for other in client.other_clients():
        motor = other.motor_call
        if motor is None or other.motor_on is not False:
            continue
        if (own is None or own.request.time < motor.request.time) and motor.request.time < call.request.time:
            return _motor_reason("switched-off-by-other", motor, client=client_place(other.conversation))
    return None


def _motor_reason(case: str, motor: Call, **places: ClientPlace) -> RefusalReason:
    message = Message(
        f"reason.motor.{case}", motor=call_place(motor), at=Moment(motor.request.time), **places
    )
    return RefusalReason(message, evidence_call=motor)


def _explain_reset(call: Call, client: ClientState) -> RefusalReason | None:
    error = client.uncleared_error
    return RefusalReason(explaining_calls=() if error is None else (error.number,))


REFUSALS: tuple[Refusal, ...] = (
    Refusal("robot-still-moving", _MOVING_CODES, _explain_moving),
    Refusal("arm-taken-by-other", _ARM_CODES, _explain_arm_taken),
    Refusal("arm-not-taken", _ARM_CODES, _explain_arm_missing),
    Refusal("motor-off", _MOTOR_CODES, _explain_motor),
    Refusal("motor-switching-off", (0x8350106E,)),
    Refusal("emergency-stop", _STOP_CODES),
    Refusal("not-in-automatic-mode", _MODE_CODES),
    Refusal("no-executable-token", _TOKEN_CODES),
    Refusal("no-licence", _LICENCE_CODES),
    Refusal("manual-reset-missing", _RESET_CODES, _explain_reset),
    Refusal("robslave-not-running", (), _explain_robslave),
)
