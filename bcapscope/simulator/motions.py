"""Ordinary motions: Robot_Move, Drive, Approach, Depart, Halt, Hold, Unhold.

A call lasts as long as its motion (unless NEXT), to the end of the command, with @E until the encoders have
arrived; with @P the next motion may begin when most of the way is done. What a second motion is answered
meanwhile is 80010004, after the ANSI-C client's b-Cap.h; that client repeats its Robot_Move then.
"""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import NamedTuple

from bcapscope.protocol.hresult import E_INVALIDARG, E_NOTIMPL, E_ROBOTISBUSY
from bcapscope.protocol.variant import VT, Variant
from bcapscope.simulator.arm import MS
from bcapscope.simulator.context import Commands, Context
from bcapscope.simulator.journey import Journey
from bcapscope.simulator.kinematics import AXIS_COUNT, Joints, joints_of_position, position, trans
from bcapscope.simulator.outcome import DONE, Answer, Outcome, RefusedError, Running
from bcapscope.simulator.posenotation import END_OF_ENCODERS, LONGEST, PASSING, Target, parse_target
from bcapscope.simulator.values import bstr, integer_of, items_of, nth, number_of, text_of

IS_STOPPING = 0x83201404
LONGEST_TIME = 3_600_000
"""ms; ours."""

_PTP, _LINE = 1, 2
_GIVEN = re.compile(r"\b(SPEED|TIME)\s*=\s*([^\s,]+)")


def move(context: Context, interpolation: Variant, pose: Variant, option: Variant) -> Outcome:
    """Run Robot_Move; a line is followed like PTP here.

    Raises:
        RefusedError: circles and free curves, among the reasons of every motion.
    """
    if integer_of(interpolation) not in (_PTP, _LINE):
        raise RefusedError(E_NOTIMPL)
    target = parse_target(pose, context.machine.memory.read)
    return run_motion(context, target, text_of(option))


def drive(context: Context, ways: list[tuple[int, float]], absolute: bool, option: str) -> Outcome:
    """Move single axes (1..6) by, or to, angles in degrees."""
    joints = list(context.machine.arm.goal)
    for axis, way in ways:
        if not 1 <= axis <= AXIS_COUNT:
            raise RefusedError(E_INVALIDARG)
        joints[axis - 1] = way if absolute else joints[axis - 1] + way
    return run_motion(context, Target(tuple(joints), _passing(option)), option)


def halt(context: Context) -> Outcome:
    """Stop the arm at once; a motion under way answers 83201404, slave mode ends."""
    context.machine.stop(context.now, IS_STOPPING)
    return DONE


def hold(context: Context) -> Outcome:
    """Pause the motion under way, if there is one; the call that waits for it waits on."""
    if context.machine.journey:
        context.machine.journey.hold(context.now)
    return DONE


def unhold(context: Context) -> Outcome:
    """Let a motion that is paused go on, whoever it belongs to.

    Raises:
        RefusedError: the controller has trouble.
    """
    machine = context.machine
    if machine.journey and machine.is_held:
        machine.check_state()
        machine.journey.resume(context.now)
    return DONE


def run_motion(context: Context, target: Target, option: str = "") -> Outcome:
    """Begin a motion.

    Raises:
        RefusedError: the robot is busy, not ready, or cannot go there.
    """
    machine, now = context.machine, context.now
    machine.check_motion(context.client, now)
    if now < machine.free_at:
        raise RefusedError(E_ROBOTISBUSY)
    machine.check_reach(target.joints)
    manner = _manner(option)
    speed = machine.speeds.share_at(manner.speed)
    journey = Journey(machine.arm, target.joints, now, speed, passing=target.passing, least=manner.time)
    machine.journey = journey
    return DONE if manner.next else _running(context, journey)


class _Manner(NamedTuple):
    """How a motion is to be made.

    Attributes:
        speed: internal speed in percent; None for that of the robot.
        time: ns that it is to take at least.
        next: the call does not wait for its end.
    """

    speed: float | None
    time: int
    next: bool


def _manner(option: str) -> _Manner:
    """Read an option such as `SPEED=50, TIME=2000, NEXT`; that the time is in ms is assumed."""
    text = option[:LONGEST].upper()
    given = dict(_GIVEN.findall(text))
    speed = number_of(bstr(given["SPEED"])) if "SPEED" in given else None
    time = number_of(bstr(given.get("TIME", "0")))
    if not 0 <= time <= LONGEST_TIME or (speed is not None and not 0 < speed <= 100):
        raise RefusedError(E_INVALIDARG)
    return _Manner(speed, round(time * MS), "NEXT" in text.replace(",", " ").split())


def _running(context: Context, journey: Journey) -> Running:
    machine, stops = context.machine, context.machine.stops

    def poll(now: int) -> Answer | None:
        if machine.stops != stops:
            return Answer(machine.stopped_by)
        return DONE if now >= journey.done else None

    return Running(poll, lambda now: journey.done)


def _passing(option: str) -> int:
    folded = option.upper()
    return END_OF_ENCODERS if "@E" in folded else PASSING if "@P" in folded else 0


def _beside(joints: Joints, distance: float) -> Joints:
    """Return the joints `distance` mm before a position, along the approach vector."""
    here = position(joints)
    vector = trans(joints)[6:9]
    return joints_of_position((*(a - distance * b for a, b in zip(here, vector, strict=False)), *here[3:]))


def _distance(part: Variant) -> tuple[float, int]:
    """Read `@P 10`, `10` or a number; return mm and the pass."""
    if not isinstance(part.value, str):
        return float(number_of(part)), 0
    last = part.value.split()[-1:] or ["0"]
    return float(number_of(Variant(VT.BSTR, last[0]))), _passing(part.value)


def approach(context: Context, parameter: Variant) -> Outcome:
    """Run Approach: interpolation, pose, distance."""
    items = items_of(parameter)
    target = parse_target(nth(items, 1), context.machine.memory.read)
    distance, passing = _distance(nth(items, 2))
    return run_motion(context, Target(_beside(target.joints, distance), passing), _option(items, 3))


def depart(context: Context, parameter: Variant) -> Outcome:
    """Run Depart: interpolation, distance."""
    items = items_of(parameter)
    distance, passing = _distance(nth(items, 1))
    goal = _beside(context.machine.arm.goal, distance)
    return run_motion(context, Target(goal, passing), _option(items, 2))


def _option(items: tuple[Variant, ...], index: int) -> str:
    return text_of(items[index]) if index < len(items) else ""


def _drive_by(context: Context, parameter: Variant) -> Outcome:
    return _drive_many(context, parameter, False)


def _drive_to(context: Context, parameter: Variant) -> Outcome:
    return _drive_many(context, parameter, True)


def _drive_many(context: Context, parameter: Variant, absolute: bool) -> Outcome:
    """Run DriveEx or DriveAEx: pairs of axis and angle, then an option."""
    items = items_of(parameter)
    ways = [
        (integer_of(nth(pair, 0)), float(number_of(nth(pair, 1))))
        for pair in map(items_of, items_of(nth(items, 0)))
    ]
    return drive(context, ways, absolute, _option(items, 1))


MOTION_COMMANDS: Commands = MappingProxyType(
    {"approach": approach, "depart": depart, "driveex": _drive_by, "driveaex": _drive_to}
)
"""Commands of Robot_Execute by their names in lower case."""
