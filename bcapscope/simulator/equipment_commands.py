"""Commands for hands, groups of robots, forces, areas, scenes and buttons, and the extensions Hand0 and Comm.

No force acts on the simulated robot. On a real controller, SyncTimeStart and SyncMoveStart synchronise
several robots. The simulator has only one robot, so these commands change no motion. The simulator only
refuses a start command before the previous end command, and an end command without a start command.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.simulator.argument_values import (
    boolean,
    bstr,
    float_array,
    i4,
    integer_of,
    number_within,
    numbers_of,
    r8,
    text_of,
    variant_array,
)
from bcapscope.simulator.call_context import CallContext, CallHandler, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import (
    DONE,
    CallResult,
    HandlerOutcome,
    RefusalCode,
    RefusedError,
    RunningCall,
)
from bcapscope.simulator.equipment import MAX_AREAS, MAX_LINES, Hand

BRACKET_IS_OPEN = {"time": 0x83500189, "move": 0x83500190}
BRACKET_IS_CLOSED = {"time": 0x83500191, "move": 0x83500192}

_STORED_SPEED, _STORED_FORCE = 0.5, 10.0
"""Assumed settings in the controller: hand speed as a share of top speed, and COBOTTA's grip force in N."""

_WEAKEST_SUCTION = 40.0
"""Percent: DENSORobot/denso_cobotta_ros denso_cobotta_gripper/config/gripper_vacuum.yaml."""

_EXTERNAL_GRIP = 1
"""Mode 1 of the 2FG hand, in which the fingers grip an object from the outside."""

_SUCTION, _SUCTION_LOAD = -0.5, 50.0
"""Assumed data of the vacuum hand: pressure in kPa per percent of power, and load in percent."""


def _move_to(context: CallContext, relative: bool = False, grips: bool = False) -> HandlerOutcome:
    """Parameters: width or distance [mm], speed [%] and, for a grip, force [N]."""
    items, hand = context.items, context.machine.equipment.hand
    goal = items.number(0) + (hand.width(context.now) if relative else 0.0)
    speed = _speed(hand, items.number(1))
    force = _force(hand, items.number(2)) if grips else 0.0
    beyond = RefusalCode.RELATIVE_GRIP_BEYOND_LIMIT if relative else RefusalCode.GRIP_BEYOND_LIMIT
    _check_width(hand, goal, beyond if grips else RefusalCode.HAND_SETTING)
    return _start(context, hand, goal, speed, force, waits=not _has_next_option(items[3 if grips else 2 :]))


def _grip(context: CallContext) -> HandlerOutcome:
    """Parameters: force [N], and whether the hand closes."""
    items, hand = context.items, context.machine.equipment.hand
    force = _force(hand, items.number(0))
    goal = hand.limits.narrowest if items.number(1) else hand.limits.widest
    return _start(context, hand, goal, hand.limits.grip_speed, force, waits=not _has_next_option(items[2:]))


def _chuck(context: CallContext, closes: bool) -> HandlerOutcome:
    hand = context.machine.equipment.hand
    return _start_with_stored_data(context, hand, closes, _STORED_FORCE, waits=True)


def _suck(context: CallContext) -> None:
    """Parameters: power [%], and whether the hand sucks. HandStop switches the vacuum off."""
    power, draws = context.items.number(0), context.items.number(1)
    context.machine.check_motor(context.now)
    _check_range(power, _WEAKEST_SUCTION, 100)
    context.machine.equipment.vacuum = power if draws else 0.0


def _stop(context: CallContext) -> None:
    equipment = context.machine.equipment
    equipment.hand.stop(context.now, RefusalCode.HAND_STOPPED)
    equipment.vacuum = 0.0


def _two_finger_grip(context: CallContext) -> HandlerOutcome:
    """Parameters: width [mm], force [N], speed [%], and whether to wait for the end of the motion."""
    items, hand = context.items, context.machine.equipment.gripper
    width, force, speed = items.number(0), _force(hand, items.number(1)), _speed(hand, items.number(2))
    waits = items.integer(3, default=1) != 0
    _check_width(hand, width)
    return _start(context, hand, width, speed, force, waits=waits)


def _two_finger_release(context: CallContext) -> HandlerOutcome:
    """Parameters: width [mm], and whether to wait for the end of the motion."""
    items, hand = context.items, context.machine.equipment.gripper
    width = items.number(0)
    _check_width(hand, width)
    return _start(context, hand, width, hand.limits.speed, 0.0, waits=items.integer(1, default=1) != 0)


def _hand_grip(context: CallContext, closes: bool) -> HandlerOutcome:
    hand = context.machine.equipment.gripper
    return _start_with_stored_data(context, hand, closes, hand.limits.weakest, waits=False)


def _start_with_stored_data(
    context: CallContext, hand: Hand, closes: bool, force: float, *, waits: bool
) -> RunningCall | None:
    """Close or open a hand with the speed that the controller stores. Only closing uses `force` [N]."""
    limits = hand.limits
    goal, force = (limits.narrowest, force) if closes else (limits.widest, 0.0)
    return _start(context, hand, goal, limits.speed * _STORED_SPEED, force, waits=waits)


def _start(
    context: CallContext, hand: Hand, goal: float, speed: float, force: float, *, waits: bool
) -> RunningCall | None:
    """Begin a motion of a hand. Refuse the call if the hand is moving or the controller's state forbids a
    motion. COBOTTA's hand moves only while the robot's motor is on. If `waits`, the call lasts until the
    motion ends. A grip of the 2FG hand then fails if the hand grips no object.
    """
    is_gripper = hand is context.machine.equipment.gripper
    if is_gripper:
        context.machine.check_state()
    else:
        context.machine.check_motor(context.now)
    if hand.is_moving(context.now):
        raise RefusedError(RefusalCode.HAND_IS_MOVING)
    ends = hand.move(goal, speed, context.now, force)
    if not waits:
        return None
    missed = is_gripper and force > 0 and not hand.is_gripping(ends)
    last, run = CallResult(RefusalCode.NOTHING_GRIPPED) if missed else DONE, hand.motion_count

    def poll(now: int) -> CallResult | None:
        if hand.motion_count != run:
            return CallResult(hand.stopped_by)
        return last if now >= ends else None

    return RunningCall(poll, lambda now: ends)


def _check_range(
    value: float, lowest: float, highest: float, refusal: int = RefusalCode.HAND_SETTING
) -> None:
    if not lowest <= value <= highest:
        raise RefusedError(refusal)


def _check_width(hand: Hand, width: float, refusal: int = RefusalCode.HAND_SETTING) -> None:
    _check_range(width, hand.limits.narrowest, hand.limits.widest, refusal)


def _speed(hand: Hand, percent: float) -> float:
    _check_range(percent, hand.limits.slowest, 100)
    return hand.limits.speed * percent / 100


def _force(hand: Hand, force: float) -> float:
    _check_range(force, hand.limits.weakest, hand.limits.strongest)
    return force


def _has_next_option(rest: tuple[Variant, ...]) -> bool:
    """Return whether NEXT lets the call return before the motion ends. The option DetectOn has no effect."""
    return any("next" in text_of(item).casefold().replace(",", " ").split() for item in rest)


def _width(context: CallContext) -> Variant:
    return r8(context.machine.equipment.hand.width(context.now))


def _of_gripper(read: Callable[[Hand, int], HandlerOutcome]) -> CallHandler:
    return lambda context: read(context.machine.equipment.gripper, context.now)


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
    "handholdstate": lambda context: boolean(context.machine.equipment.hand.is_gripping(context.now)),
    "handcurpos": _width,
    "handcurpressure": lambda context: r8(context.machine.equipment.vacuum * _SUCTION),
    "handcurload": lambda context: r8(_SUCTION_LOAD if context.machine.equipment.vacuum else 0.0),
}

HAND_EXTENSION_COMMANDS: CommandTable = {
    "curpos": _width,
    "chuck": HAND_COMMANDS["handchuck"],
    "unchuck": HAND_COMMANDS["handunchuck"],
}


_FORCE_CONTROLS = range(1, 11)
_MAX_FORCE_VALUES = 14
_LINE_IS_OPEN = 2
_SIX = (0.0,) * 6


def _switch_bracket(context: CallContext, name: str, opens: bool) -> None:
    brackets = context.machine.equipment.brackets
    if (name in brackets) == opens:
        raise RefusedError(BRACKET_IS_OPEN[name] if opens else BRACKET_IS_CLOSED[name])
    (brackets.add if opens else brackets.remove)(name)


def _force_control(context: CallContext) -> None:
    """Parameters: on or off, a number 1..10 and a mode. Force control changes no motion."""
    context.machine.check_arm(context.client)
    if context.items.integer(0) != 0:
        number_within(context.items.at(1), _FORCE_CONTROLS, E_INVALIDARG)


def _force_parameters(context: CallContext) -> None:
    """Parameters: number 1..10, coordinates 0..2, six forces, and up to eleven more values."""
    items = context.items
    number_within(items.at(0), _FORCE_CONTROLS, E_INVALIDARG)
    number_within(items.at(1), range(3), E_INVALIDARG)
    if len(items) > _MAX_FORCE_VALUES or len(numbers_of(items.at(2))) < len(_SIX):
        raise RefusedError(E_INVALIDARG)


def _checked(check: Callable[[CallContext], object], value: Variant | None = None) -> CallHandler:
    def run(context: CallContext) -> Variant | None:
        check(context)
        return value

    return run


def _check_button(context: CallContext) -> None:
    number_within(context.parameter, range(3), RefusalCode.BAD_INDEX)


def _check_scene(context: CallContext) -> None:
    if any([context.items.integer(index) for index in (0, 1)]):
        raise RefusedError(RefusalCode.BAD_INDEX)


def _switch_area(context: CallContext) -> None:
    areas = context.machine.equipment.areas
    (areas.add if context.items.number(1) else areas.discard)(_area(context))


def _area(context: CallContext) -> int:
    return number_within(context.items.at(0), range(MAX_AREAS), RefusalCode.BAD_INDEX)


def _line(context: CallContext) -> int:
    return number_within(context.parameter, range(MAX_LINES), RefusalCode.BAD_INDEX)


EQUIPMENT_COMMANDS: CommandTable = {
    "handgrip": partial(_hand_grip, closes=True),
    "handrelease": partial(_hand_grip, closes=False),
    "twofggrip": _two_finger_grip,
    "twofgrelease": _two_finger_release,
    "twofgstop": _of_gripper(lambda hand, now: hand.stop(now, RefusalCode.HAND_STOPPED)),
    "twofgisconn": lambda context: i4(1),
    "twofgisbusy": _of_gripper(lambda hand, now: i4(int(hand.is_moving(now)))),
    "twofgisgrip": _of_gripper(lambda hand, now: i4(int(hand.is_gripping(now)))),
    "twofggeterrorcode": lambda context: i4(0),
    "twofggetmode": lambda context: i4(_EXTERNAL_GRIP),
    "twofggetwidth": _of_gripper(lambda hand, now: r8(hand.width(now))),
    "twofggetminwidth": _of_gripper(lambda hand, now: r8(hand.limits.narrowest)),
    "twofggetmaxwidth": _of_gripper(lambda hand, now: r8(hand.limits.widest)),
    "twofggetforce": _of_gripper(lambda hand, now: r8(hand.force(now))),
    "synctimestart": partial(_switch_bracket, name="time", opens=True),
    "synctimeend": partial(_switch_bracket, name="time", opens=False),
    "syncmovestart": partial(_switch_bracket, name="move", opens=True),
    "syncmoveend": partial(_switch_bracket, name="move", opens=False),
    "forcectrl": _force_control,
    "forceparam": _force_parameters,
    "forcevalue": _checked(lambda context: context.items.integer(0), float_array(VT.R8, _SIX)),
    # The parameter 0 resets the sensor.
    "forcesensor": _checked(lambda context: number_within(context.parameter, range(1), E_INVALIDARG)),
    # Mass, centre and inertia.
    "curforcesensorpayload": lambda context: variant_array(
        r8(0.0), float_array(VT.R8, _SIX[:3]), float_array(VT.R8, _SIX[:3])
    ),
    "forcewaitcondition": accept_without_effect,
    "autocal": accept_without_effect,
    # RobInfo returns the type name if the parameter is 1, and an empty text for any other parameter.
    "robinfo": lambda context: bstr(
        context.machine.initial_state.type_name if integer_of(context.parameter) == 1 else ""
    ),
    # The buttons 0 to 2 are never pressed.
    "getmechabuttonstate": _checked(_check_button, i4(0)),
    "clearmechabuttonstate": _checked(_check_button, i4(0)),
    "curscene": lambda context: i4(0),
    "cursubscene": lambda context: i4(0),
    # The result holds the scene, the sub-scene and an empty name.
    "sceneinfo": _checked(_check_scene, variant_array(i4(0), i4(0), bstr(""))),
    "setareaenabled": _switch_area,
    "getareaenabled": lambda context: boolean(_area(context) in context.machine.equipment.areas),
}

LINE_COMMANDS: CommandTable = {
    # All communication lines exist, but no device is connected to them.
    "open": lambda context: context.machine.equipment.lines.add(_line(context)),
    "close": lambda context: context.machine.equipment.lines.discard(_line(context)),
    "state": lambda context: i4(_LINE_IS_OPEN if _line(context) in context.machine.equipment.lines else 0),
    "clear": _checked(_line),
    "count": _checked(_line, i4(0)),
    "input": _checked(_line, bstr("")),
}
