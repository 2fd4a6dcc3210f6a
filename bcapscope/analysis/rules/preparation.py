"""What must be done before the robot moves: program, standstill, arm, motor, mode, permission."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients, argument, command_of, gets_robslave
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import NO_MORE, Refusal, Why, fixed, refusal
from bcapscope.analysis.rules.rule import MS, SECOND, Kind, Rule, Watcher
from bcapscope.analysis.speech import Speech, called, name_of, span
from bcapscope.protocol.effects import Effect
from bcapscope.protocol.enumerations import pass_motion
from bcapscope.protocol.functions import ID
from bcapscope.protocol.guard import request_effect
from bcapscope.protocol.hresult import E_ARM_NOT_TAKEN, describe, is_failure
from bcapscope.protocol.slavemode import Generation, mode_value
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.question import Question

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_ERRORS = "public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
_EVER = 24 * 3600 * SECOND

ROBSLAVE = Rule(
    "robslave-not-running",
    Severity.ERROR,
    "on an RC7 slave mode is refused, and RobSlave was not started, or an error has stopped it",
    "Start the task RobSlave (RobSlave.pac) over b-CAP before slvChangeMode, and again after each error.",
    f"{_SEED}, Starting your client app. and Error, and the sequence of clearing error",
    ("controller-error", "underflow", "over-limit"),
    _EVER,
)
NO_AT_E = Rule(
    "no-at-e",
    Severity.WARNING,
    "the last motion before slvChangeMode does not end with @E, and slvChangeMode had to wait for it",
    "End the last motion before slvChangeMode with @E: the call then returns when the robot stands still.",
    f"{_SEED}, slvChangeMode",
)
STILL_MOVING = Rule(
    "robot-still-moving",
    Severity.ERROR,
    "a call is refused since the robot moves (600B, 8150100D)",
    "Wait for standstill, best by @E on the motion before: slvChangeMode itself waits no longer than 500 ms.",
    f"{_SEED}, slvChangeMode; {_ERRORS}",
    ("no-at-e",),
    10 * SECOND,
)
ARM_MISSING = Rule(
    "arm-not-taken",
    Severity.ERROR,
    "a call needs the arm, and TakeArm was not called (83501024)",
    "Call TakeArm after Controller_GetRobot and before Motor and slvChangeMode; an error or an emergency "
    "stop can take the arm away again.",
    f"DENSORobot/denso_robot_ros issue 29; {_ERRORS}",
    ("emergency-stop", "controller-error"),
    60 * SECOND,
)
ARM_TAKEN = Rule(
    "arm-taken-by-other",
    Severity.ERROR,
    "a call needs the arm, and another client has it (83501024)",
    "Let that client call GiveArm, or do all motion in one process.",
    f"DENSORobot/denso_robot_ros issues 21, 29 and 48; {_ERRORS}",
)
MOTOR = Rule(
    "motor-off",
    Severity.ERROR,
    "a call needs the motor, and it is off (81501003)",
    "Call Motor with 1 and wait for its reply; after an error of level 4 or 5 (84xxxxxx, 85xxxxxx) the motor "
    "is off, and ClearError comes first.",
    _ERRORS,
    ("underflow", "over-limit", "beyond-range", "emergency-stop", "controller-error", "motor-switching-off"),
    _EVER,
)
SWITCHING = Rule(
    "motor-switching-off",
    Severity.ERROR,
    "Motor on is refused while the motor is still switching off (8350106E)",
    "Repeat Motor on until it is accepted.",
    "nkawa/Denso_CobottaPro900_MQTT_Control",
    ("underflow", "over-limit", "beyond-range", "controller-error"),
    60 * SECOND,
)
EMERGENCY = Rule(
    "emergency-stop",
    Severity.ERROR,
    "an emergency stop, protective stop or safety state is on",
    "Release the stop at the robot, then ManualReset (RC9) or ManualResetPreparation (COBOTTA), "
    "ClearError and Motor on.",
    _ERRORS,
)
NOT_AUTO = Rule(
    "not-in-automatic-mode",
    Severity.ERROR,
    "the pendant's mode, machine lock or enable switch does not allow the call",
    "Set the mode on the pendant as the code says; slave mode needs (external) automatic mode.",
    f"{_SEED}, Preparation; {_ERRORS}",
)
TOKEN = Rule(
    "no-executable-token",
    Severity.ERROR,
    "the executable token is not given to Ethernet and this client's address",
    "Set the executable token to Ethernet on the pendant and enter the client's IP address there.",
    f"{_SEED}, Setting up your RC7; DENSORobot/denso_robot_ros issues 29 and 36",
)
LICENCE = Rule(
    "no-licence",
    Severity.ERROR,
    "a licence or option is missing on the controller",
    "Enter the licence of b-CAP slave mode (on an RC7 option 1214, ORiN) and enable it on the pendant.",
    f"{_SEED}, Setting up your RC7; {_ERRORS}",
)
RESET_MISSING = Rule(
    "manual-reset-missing",
    Severity.ERROR,
    "a COBOTTA wants ManualResetPreparation or MotionPreparation first",
    "Call ManualResetPreparation, then ClearError, then MotionPreparation, then Motor on.",
    f"DENSORobot/denso_robot_ros issues 36 and 44; {_ERRORS}",
    ("no-executable-token",),
    60 * SECOND,
)
TYPE_UNREAD = Rule(
    "type-not-checked",
    Severity.NOTE,
    "the client moves the robot without having asked for its type",
    "Read @TYPE or GetRobotTypeName before the first motion, so that no program meant for another "
    "robot runs.",
    f"{_SEED}, Starting your client app. (tips)",
)

_MOVING_CODES = (0x600B, 0x8000600B, 0x8150100D, 0x81201744)
_STOP_CODES = (0x8150101A, 0x8120170A, 0x83500178, 0x81501022, 0x8150101C, 0x8150101E, 0x81501078, 0x83501079)
_STOP_CODES_RC7 = (0x2008, 0x80002008)
_MODE_CODES = (
    *range(0x81501012, 0x81501018),
    *(0x81501005, 0x81201705, 0x81201748, 0x81501007, 0x81501020, 0x81501021, 0x81501023),
    *(0x21E2, 0x21E3, 0x21E4, 0x21E5, 0x21E6, 0x21E7, 0x21F2, 0x21F3, 0x21FC),
)
_TOKEN_CODES = (
    0x83501026,
    0x83501027,
    0x83501028,
    0x83501029,
    0x80501043,
    0x80501044,
    0x2287,
    0x2288,
    0x2289,
)
_LICENCE_CODES = (0x80000901, 0x8000020C, 0x83500009, 0x83500126)
_RESET_CODES = (0x83500372, 0x81501069, 0x81501070)
_SWITCHES_OFF = 4
"""Errors of this level stop all axes and switch the motor off; of those below it, the list does not say."""
_MOTOR_CODES = (0x81501003, 0x2006, 0x80002006)
_ARM_CODES = (E_ARM_NOT_TAKEN, 0x21F7, 0x800021F7)

_WAITED = 100 * MS
_JUST_BEFORE = 5 * SECOND


class Preparation(Watcher):
    """Looks at what came before slave mode and the first motion."""

    rules = (NO_AT_E, TYPE_UNREAD)

    def heeds(self, question: Question, kind: Kind) -> bool:
        command = command_of(question)
        return command == "slvchangemode" or (kind is not Kind.REFUSED and command != "slvmove")

    def call(self, call: Exchange, client: Client) -> None:
        if command_of(call.question) == "slvchangemode" and _asks_for_mode(call):
            self._look_at_motion_before(call, client)
            self._look_for_type(call, client)
        elif client.motion is None and not client.type_read and _moves(call):
            self._look_for_type(call, client)

    def _look_at_motion_before(self, call: Exchange, client: Client) -> None:
        motion = client.motion
        if motion is None or call.reply is None or _ends_at_e(motion):
            return
        waited = call.reply.time - call.request.time
        code = call.reply.item.code
        just = call.request.time - motion.request.time < _JUST_BEFORE
        if not just or not (code in _MOVING_CODES or (waited >= _WAITED and not is_failure(code))):
            return

        def say(speech: Speech) -> str:
            ending = _passes(motion)
            how = f"passes with {ending}" if ending else "has no @E"
            return (
                f"the last motion before {called(call)}, {called(motion)}, {how}, and slvChangeMode "
                f"waited {span(waited)} for standstill"
            )

        self.tell(NO_AT_E, call, say, before=motion, began=motion.request.time, time=call.request.time)

    def _look_for_type(self, call: Exchange, client: Client) -> None:
        if client.type_read or client.motion is not None or not client.seen_from_start:
            return
        client.type_read = True  # once is enough
        self.tell(
            TYPE_UNREAD,
            call,
            lambda speech: (
                f"{speech.client(call.conversation)} went on to {name_of(call)} without having read "
                "the robot's type"
            ),
        )


def _moves(call: Exchange) -> bool:
    """Tell whether a call moves the robot's arm."""
    function_id, command = call.question
    if function_id in _MOTION_FUNCTIONS:
        return True
    frame = call.request.item
    if function_id != ID["Robot_Execute"] or command is None:
        return False
    return request_effect(frame.code, [each.variant for each in frame.arguments]) is Effect.MOVES


_MOTION_FUNCTIONS = frozenset(ID[f"Robot_{verb}"] for verb in ("Move", "Drive", "GoHome", "Rotate"))


def _asks_for_mode(call: Exchange) -> bool:
    parameter = argument(call, 2)
    return parameter is not None and mode_value(parameter) != 0


def _passes(motion: Exchange) -> str:
    """Return the pass of a motion as it was asked for, such as `@P` or `@0`; empty where it names none."""
    for index in (2, 3):
        found = _pass_in(argument(motion, index))
        if found:
            return found
    return ""


def _pass_in(variant: Variant | None) -> str:
    value = variant.value if variant is not None else None
    if isinstance(value, str):
        return next((word[:4] for word in value.split() if word.startswith("@")), "")
    if not isinstance(value, tuple):
        return ""
    if len(value) > 2 and isinstance(value[2], Variant) and isinstance(value[2].value, int):
        return pass_motion(value[2].value)
    return next((found for item in value[:8] if isinstance(item, Variant) and (found := _pass_in(item))), "")


def _ends_at_e(motion: Exchange) -> bool:
    return _passes(motion).casefold() == "@e"


def _robslave(call: Exchange, client: Client, clients: Clients) -> Why | None:
    command = command_of(call.question)
    code = call.hresult or 0
    if gets_robslave(call):
        return fixed("the controller has no program of that name, and an RC7 needs it running in slave mode")
    if command not in ("slvchangemode", "slvmove") or not (
        client.generation is Generation.RC7 or code <= 0xFFFF
    ):
        return None
    if code in (*_MOVING_CODES, *_MODE_CODES, *_MOTOR_CODES, *_ARM_CODES):
        return None
    started = client.robslave
    if started is None:
        return _never_started(client)
    stopped = client.failure or _error_after(started, client)
    if stopped is None or stopped.call < started.call:
        return None
    return Why(
        lambda speech: (
            f"RobSlave was started by {called(started)}, the error of {called(stopped)} stopped it, and it "
            "was not started again"
        ),
        because=(stopped.call,),
        before=stopped,
    )


def _never_started(client: Client) -> Why | None:
    missing = client.robslave_missing
    if missing is not None:
        return Why(lambda speech: f"{called(missing)} had not found RobSlave", because=(missing.call,))
    if not client.seen_from_start:
        return None
    return fixed("no Task_Start of RobSlave was seen from this client, and an RC7 needs it running")


def _error_after(started: Exchange, client: Client) -> Exchange | None:
    ended = client.mode_end
    failed = ended is not None and ended.hresult is not None and is_failure(ended.hresult)
    return ended if failed and ended is not None and ended.call > started.call else None


def _moving(call: Exchange, client: Client, clients: Clients) -> Why | None:
    motion = client.motion
    if motion is None:
        return NO_MORE
    since = span(call.request.time - motion.request.time)
    return Why(
        lambda speech: f"{called(motion)} had been sent {since} before",
        before=motion,
        then=lambda speech, after: (
            f"{name_of(call)} was refused (0x{call.hresult or 0:08X}, the robot moved)"
        ),
        because=(call.call,),
    )


def _arm_taken(call: Exchange, client: Client, clients: Clients) -> Why | None:
    holder = next((other for other in clients.others(client) if other.arm is not None), None)
    if holder is None or holder.arm is None:
        if command_of(call.question) != "takearm":
            return None
        return fixed("whoever has it is not in this capture: the pendant, or a client on another network")
    taken = holder.arm
    return Why(
        lambda speech: (
            f"{speech.client(holder.conversation)} took the arm at {speech.at(taken.request.time)} "
            "and has not given it back"
        ),
        before=taken,
    )


def _arm_missing(call: Exchange, client: Client, clients: Clients) -> Why | None:
    if client.arm is not None:
        taken = client.arm
        return Why(
            lambda speech: (
                f"the arm was taken at {speech.at(taken.request.time)} and lost since, perhaps by "
                "an error or a stop"
            ),
            before=taken,
        )
    if client.seen_from_start:
        return fixed("this client had not called TakeArm")
    return fixed("no TakeArm of this client was seen in the capture")


def _motor(call: Exchange, client: Client, clients: Clients) -> Why | None:
    motor, failure = client.motor, client.failure
    if motor is not None and client.motor_on is False:
        return Why(
            lambda speech: f"{called(motor)} had switched it off at {speech.at(motor.request.time)}",
            before=motor,
        )
    if failure is not None and (motor is None or motor.request.time < failure.request.time):
        level = describe(failure.hresult or 0).level
        grave = level is not None and level >= _SWITCHES_OFF
        how = "most likely" if grave else "perhaps"
        return Why(
            lambda speech: f"{how} the error of {called(failure)} had switched it off",
            because=(failure.call,) if grave else (),
        )
    if motor is None:
        return fixed("this client had not called Motor, as far as was seen")
    if client.motor_on is None:
        return Why(
            lambda speech: (
                f"{called(motor)} had been accepted at {speech.at(motor.request.time)}, and its argument "
                "does not tell what it switched"
            ),
            before=motor,
        )
    return Why(
        lambda speech: (
            f"{called(motor)} had switched it on at {speech.at(motor.request.time)}, and something "
            "switched it off since"
        ),
        before=motor,
    )


def _reset(call: Exchange, client: Client, clients: Clients) -> Why | None:
    return Why(because=() if client.failure is None else (client.failure.call,))


REFUSALS: tuple[Refusal, ...] = (
    refusal(ROBSLAVE, (), _robslave),
    refusal(STILL_MOVING, _MOVING_CODES, _moving),
    refusal(ARM_TAKEN, _ARM_CODES, _arm_taken),
    refusal(ARM_MISSING, _ARM_CODES, _arm_missing),
    refusal(MOTOR, _MOTOR_CODES, _motor),
    refusal(SWITCHING, (0x8350106E,)),
    refusal(EMERGENCY, (*_STOP_CODES, *_STOP_CODES_RC7)),
    refusal(NOT_AUTO, _MODE_CODES),
    refusal(TOKEN, _TOKEN_CODES),
    refusal(LICENCE, _LICENCE_CODES),
    refusal(RESET_MISSING, _RESET_CODES, _reset),
)
