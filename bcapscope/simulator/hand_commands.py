"""Commands of the hands: COBOTTA's electric and vacuum hand, the extension Hand0, and the 2FG hand.

Sources for parameters: ShoheiKobata/orin_bcap_python_samples and public ROS bridges of COBOTTA (HandMove...,
HandCurPos, HandHoldState), DENSORobot/denso_cobotta_ros issue 22 (HandMoveH, HandChuck, options), and DENSO's
texts in nkawa/Denso_CobottaPro900_MQTT_Control (HandGrip, HandRelease, Twofg...). Source for the codes: the
list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control. Source for fingers that touch an object
without gripping it: DENSORobot/denso_robot_ros issue 46. Source for the fact that the hand needs the motor:
DENSORobot/denso_cobotta_ros denso_cobotta_gripper. A call lasts as long as its motion. The samples send the
next command at once, and a moving hand would refuse it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bcapscope.protocol.codec.variant import Variant
from bcapscope.simulator.argument_values import (
    argument_at,
    boolean,
    i4,
    integer_of,
    items_of,
    number_of,
    r8,
    text_of,
)
from bcapscope.simulator.call_context import CallContext, CommandHandler, CommandTable
from bcapscope.simulator.call_outcome import DONE, CallResult, HandlerOutcome, RefusedError, RunningCall
from bcapscope.simulator.equipment import Hand
from bcapscope.simulator.result_codes import (
    GRIP_BEYOND_LIMIT,
    HAND_IS_MOVING,
    HAND_SETTING,
    HAND_STOPPED,
    MOTOR_IS_OFF,
    NOTHING_GRIPPED,
    RELATIVE_GRIP_BEYOND_LIMIT,
)

_STORED_SPEED, _STORED_FORCE = 0.5, 10.0
"""Assumed data that the controller stores for a grip: share of the top speed, and COBOTTA's force in N."""

_WEAKEST_SUCTION = 40.0
"""Percent: DENSORobot/denso_cobotta_ros denso_cobotta_gripper/config/gripper_vacuum.yaml."""

_EXTERNAL_GRIP = 1
"""Mode of the 2FG hand in which the hand grips from outside."""

_SUCTION, _SUCTION_LOAD = -0.5, 50.0
"""Assumed data of the vacuum hand: pressure in kPa per percent of power, and load in percent."""


def _move_to(
    context: CallContext, parameter: Variant, relative: bool = False, grips: bool = False
) -> HandlerOutcome:
    """Run HandMoveA, -R, -AH or -RH with width or distance [mm], speed [%] and, for a grip, force [N]."""
    items, hand = items_of(parameter), context.machine.equipment.hand
    goal = float(number_of(argument_at(items, 0))) + (hand.width(context.now) if relative else 0.0)
    speed = _speed(hand, argument_at(items, 1))
    force = _force(hand, argument_at(items, 2)) if grips else 0.0
    beyond = RELATIVE_GRIP_BEYOND_LIMIT if relative else GRIP_BEYOND_LIMIT
    _check_width(hand, goal, beyond if grips else HAND_SETTING)
    return _start(context, hand, goal, speed, force, waits=not _has_next_option(items[3 if grips else 2 :]))


def _grip(context: CallContext, parameter: Variant) -> HandlerOutcome:
    """Run HandMoveH with the parameters force [N] and whether to close."""
    items, hand = items_of(parameter), context.machine.equipment.hand
    force = _force(hand, argument_at(items, 0))
    goal = hand.limits.narrowest if number_of(argument_at(items, 1)) else hand.limits.widest
    return _start(context, hand, goal, hand.limits.grip_speed, force, waits=not _has_next_option(items[2:]))


def _chuck(context: CallContext, parameter: Variant, closes: bool) -> HandlerOutcome:
    """Run HandChuck, HandUnChuck, or Chuck or Unchuck of Hand0, with the data that the controller stores."""
    hand = context.machine.equipment.hand
    return _start(context, hand, *_stored_motion(hand, closes, _STORED_FORCE), waits=True)


def _suck(context: CallContext, parameter: Variant) -> None:
    """Run HandMoveVH with the parameters power [%] and whether to draw in; HandStop ends the vacuum."""
    items = items_of(parameter)
    power = float(number_of(argument_at(items, 0)))
    draws = number_of(argument_at(items, 1)) != 0
    _check_ready(context)
    if not _WEAKEST_SUCTION <= power <= 100:
        raise RefusedError(HAND_SETTING)
    context.machine.equipment.vacuum = power if draws else 0.0


def _stop(context: CallContext, parameter: Variant) -> None:
    """Run HandStop: the call of a running motion returns 835002FF, and the vacuum goes off."""
    equipment = context.machine.equipment
    equipment.hand.stop(context.now, HAND_STOPPED)
    equipment.vacuum = 0.0


def _two_finger_grip(context: CallContext, parameter: Variant) -> HandlerOutcome:
    """Run TwofgGrip with width [mm], force [N], speed [%], whether to wait; a wait without a grip fails."""
    items, hand = items_of(parameter), context.machine.equipment.gripper
    width = float(number_of(argument_at(items, 0)))
    force, speed = _force(hand, argument_at(items, 1)), _speed(hand, argument_at(items, 2))
    waits = len(items) < 4 or integer_of(items[3]) != 0
    _check_width(hand, width, HAND_SETTING)
    return _start(context, hand, width, speed, force, waits=waits)


def _two_finger_release(context: CallContext, parameter: Variant) -> HandlerOutcome:
    """Run TwofgRelease with the parameters width [mm] and whether to wait."""
    items, hand = items_of(parameter), context.machine.equipment.gripper
    width = float(number_of(argument_at(items, 0)))
    _check_width(hand, width, HAND_SETTING)
    waits = len(items) < 2 or integer_of(items[1]) != 0
    return _start(context, hand, width, hand.limits.speed, 0.0, waits=waits)


def _hand_grip(context: CallContext, parameter: Variant, closes: bool) -> HandlerOutcome:
    """Run HandGrip or HandRelease, which move the 2FG hand with the data that the controller stores."""
    hand = context.machine.equipment.gripper
    return _start(context, hand, *_stored_motion(hand, closes, hand.limits.weakest), waits=False)


def _stored_motion(hand: Hand, closes: bool, force: float) -> tuple[float, float, float]:
    """Return goal [mm], speed [mm/s] and force [N] of a motion; `force` is the force of a grip."""
    speed = hand.limits.speed * _STORED_SPEED
    return (hand.limits.narrowest, speed, force) if closes else (hand.limits.widest, speed, 0.0)


def _start(
    context: CallContext, hand: Hand, goal: float, speed: float, force: float, *, waits: bool
) -> RunningCall | None:
    """Begin a motion, unless the state forbids it, the hand moves, or COBOTTA's motor is off.

    If the call `waits`, it lasts as long as the motion. A grip of the 2FG hand fails without an object.
    """
    is_gripper = hand is context.machine.equipment.gripper
    if is_gripper:
        context.machine.check_state()
    else:
        _check_ready(context)
    if hand.is_moving(context.now):
        raise RefusedError(HAND_IS_MOVING)
    ends = hand.move(goal, speed, context.now, force)
    if not waits:
        return None
    missed = is_gripper and force > 0 and not hand.is_gripping(ends)
    last, run = CallResult(NOTHING_GRIPPED) if missed else DONE, hand.motion_count

    def poll(now: int) -> CallResult | None:
        if hand.motion_count != run:
            return CallResult(hand.stopped_by)
        return last if now >= ends else None

    return RunningCall(poll, lambda now: ends)


def _check_ready(context: CallContext) -> None:
    context.machine.check_state()
    if not context.machine.motor_is_on(context.now):
        raise RefusedError(MOTOR_IS_OFF)


def _check_width(hand: Hand, width: float, result: int) -> None:
    if not hand.limits.narrowest <= width <= hand.limits.widest:
        raise RefusedError(result)


def _speed(hand: Hand, part: Variant) -> float:
    """Read a speed in percent, and return the speed in mm/s."""
    percent = float(number_of(part))
    if not hand.limits.slowest <= percent <= 100:
        raise RefusedError(HAND_SETTING)
    return hand.limits.speed * percent / 100


def _force(hand: Hand, part: Variant) -> float:
    force = float(number_of(part))
    if not hand.limits.weakest <= force <= hand.limits.strongest:
        raise RefusedError(HAND_SETTING)
    return force


def _has_next_option(rest: tuple[Variant, ...]) -> bool:
    """Return whether the call returns before the motion ends; the option DetectOn has no effect."""
    return any("next" in text_of(item).casefold().replace(",", " ").split() for item in rest)


def _width(context: CallContext, parameter: Variant) -> Variant:
    return r8(context.machine.equipment.hand.width(context.now))


def _of_gripper(read: Callable[[Hand, int], Variant]) -> CommandHandler:
    """Make a handler that reads the 2FG hand; `read` gets the hand and the time in ns."""
    return lambda context, parameter: read(context.machine.equipment.gripper, context.now)


HAND_COMMANDS: CommandTable = {
    "handmovea": _move_to,
    "handmover": partial(_move_to, relative=True),
    "handmoveh": _grip,
    "handmoveah": partial(_move_to, grips=True),
    "handmoverh": partial(_move_to, relative=True, grips=True),
    "handmovevh": _suck,
    "handchuck": partial(_chuck, closes=True),
    "handunchuck": partial(_chuck, closes=False),
    "handstop": _stop,
    "handholdstate": lambda context, _: boolean(context.machine.equipment.hand.is_gripping(context.now)),
    "handcurpos": _width,
    "handcurpressure": lambda context, _: r8(context.machine.equipment.vacuum * _SUCTION),
    "handcurload": lambda context, _: r8(_SUCTION_LOAD if context.machine.equipment.vacuum else 0.0),
}
"""Handlers of the hand commands of Controller_Execute by the commands' names in lower case."""

GRIPPER_COMMANDS: CommandTable = {
    "handgrip": partial(_hand_grip, closes=True),
    "handrelease": partial(_hand_grip, closes=False),
    "twofggrip": _two_finger_grip,
    "twofgrelease": _two_finger_release,
    "twofgstop": lambda context, _: context.machine.equipment.gripper.stop(context.now, HAND_STOPPED),
    "twofgisconn": lambda context, _: i4(1),
    "twofgisbusy": _of_gripper(lambda hand, now: i4(int(hand.is_moving(now)))),
    "twofgisgrip": _of_gripper(lambda hand, now: i4(int(hand.is_gripping(now)))),
    "twofggeterrorcode": lambda context, _: i4(0),
    "twofggetmode": lambda context, _: i4(_EXTERNAL_GRIP),
    "twofggetwidth": _of_gripper(lambda hand, now: r8(hand.width(now))),
    "twofggetminwidth": _of_gripper(lambda hand, now: r8(hand.limits.narrowest)),
    "twofggetmaxwidth": _of_gripper(lambda hand, now: r8(hand.limits.widest)),
    "twofggetforce": _of_gripper(lambda hand, now: r8(hand.force(now))),
}
"""Handlers of the hand commands of Robot_Execute by the commands' names in lower case."""

HAND_EXTENSION_COMMANDS: CommandTable = {
    "curpos": _width,
    "chuck": HAND_COMMANDS["handchuck"],
    "unchuck": HAND_COMMANDS["handunchuck"],
}
"""Handlers of the commands of the extension Hand0 by the commands' names in lower case."""
