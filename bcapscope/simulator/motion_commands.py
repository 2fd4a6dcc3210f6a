"""Ordinary motions: Robot_Move, Drive, Approach, Depart, Halt, Hold, Unhold.

A call usually ends when the commanded joints reach the target. With the pass motion @E, the call ends later,
when the encoders reach the target. With @P, the call ends before the joints reach the target, and the next
motion may begin as soon as the call has ended. With the option NEXT, the call ends at once.
"""

from __future__ import annotations

import re
from functools import partial

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG, E_ROBOTISBUSY
from bcapscope.simulator.argument_values import bstr, integer_of, items_of, number_of
from bcapscope.simulator.arm import MS, TimedMove
from bcapscope.simulator.call_context import CallContext, CommandTable
from bcapscope.simulator.call_outcome import DONE, CallResult, HandlerOutcome, RefusedError, RunningCall
from bcapscope.simulator.kinematics import AXIS_COUNT, Joints, joints_of_position, position, trans
from bcapscope.simulator.pose_notation import (
    END_OF_ENCODERS,
    LONGEST_POSE_TEXT,
    PASSING,
    MotionTarget,
    ReadVariable,
    parse_pass,
    parse_pass_text,
    parse_target,
)

IS_STOPPING = 0x83201404
LONGEST_TIME = 3_600_000
"""Longest TIME option in ms; the limit is bcapscope's own."""

_PTP, _LINE, _CIRCLE, _FREE_CURVE = 1, 2, 3, 4
_BETWEEN_POSES = re.compile(r",\s*(?=[@PJT])", re.IGNORECASE)
_OPTION = re.compile(r"\b(SPEED|S|ACCEL|DECEL|TIME)\s*=\s*([^\s,]+)")
_VARIABLE = re.compile(r"([IFD])([0-9]{1,9})")
_AXES = re.compile(
    r"\s*(?:@(?P<pass>[PE]|[0-9]{1,4})\s*)?(?P<pairs>\([^()]*\)(?:\s*,\s*\([^()]*\))*)\s*", re.IGNORECASE
)
_PAIR = re.compile(r"\(\s*([0-9]{1,2})\s*,\s*([^(),\s]+)\s*\)")


def move(context: CallContext) -> HandlerOutcome:
    """Handle Robot_Move. A line or circle becomes a PTP motion to the end point. For a free curve, the call
    succeeds but the robot stays where it is, because the simulator stores no curves.
    """
    arguments = context.arguments
    target = _move_target(context, arguments.at(1), arguments.integer(0))
    return run_motion(context, target, arguments.text(2, default=""))


def _move_target(context: CallContext, pose: Variant, interpolation: int) -> MotionTarget:
    read = context.machine.memory.read
    if interpolation in (_PTP, _LINE):
        return parse_target(pose, read)
    if interpolation == _CIRCLE:
        targets = [parse_target(each, read) for each in _poses(pose)]
        if len(targets) != 2:
            raise RefusedError(E_INVALIDARG)
        context.machine.check_reach(targets[0].joints)
        return targets[1]
    if interpolation != _FREE_CURVE or integer_of(pose) < 1:
        raise RefusedError(E_INVALIDARG)
    return MotionTarget(context.machine.arm.goal, 0)


def _poses(pose: Variant) -> tuple[Variant, ...]:
    """Return the two poses of a circle, written as `P1, @E P2` or as an array."""
    if not isinstance(pose.value, str):
        return items_of(pose)
    return tuple(map(bstr, _BETWEEN_POSES.split(pose.value[:LONGEST_POSE_TEXT])))


def drive(context: CallContext) -> HandlerOutcome:
    arguments = context.arguments
    axis_move = arguments.integer(0), arguments.number(1)
    option = arguments.text(2, default="")
    return _drive_axes(context, [axis_move], False, option, _parse_passing(option))


def _drive_axes(
    context: CallContext, axis_moves: list[tuple[int, float]], absolute: bool, option: str, passing: int
) -> HandlerOutcome:
    """Move single axes (1..6) by angles in degrees, or to angles if `absolute`."""
    joints = list(context.machine.arm.goal)
    for axis, way in axis_moves:
        if not 1 <= axis <= AXIS_COUNT:
            raise RefusedError(E_INVALIDARG)
        joints[axis - 1] = way if absolute else joints[axis - 1] + way
    return run_motion(context, MotionTarget(tuple(joints), passing), option)


def halt(context: CallContext) -> None:
    """Stop the arm immediately; the call of a running motion returns 83201404, and slave mode ends."""
    context.machine.stop(context.now, IS_STOPPING)


def hold(context: CallContext) -> None:
    if context.machine.current_move:
        context.machine.current_move.hold(context.now)


def unhold(context: CallContext) -> None:
    """Resume the paused motion of any client, unless the controller's state forbids motion."""
    machine = context.machine
    if machine.current_move and machine.is_held:
        machine.check_state()
        machine.current_move.resume(context.now)


def run_motion(context: CallContext, target: MotionTarget, option: str = "") -> HandlerOutcome:
    machine, now = context.machine, context.now
    machine.check_motion(context.client, now)
    if now < machine.free_at:
        raise RefusedError(E_ROBOTISBUSY)
    machine.check_reach(target.joints)
    speed, min_duration, is_next = _parse_options(option, machine.memory.read)
    share = machine.speeds.effective_share(speed)
    motion = TimedMove(
        machine.arm, target.joints, now, share, passing=target.passing, min_duration=min_duration
    )
    machine.current_move = motion
    return None if is_next else _running(context, motion)


def _parse_options(option: str, read: ReadVariable) -> tuple[float | None, int, bool]:
    """Read an option such as `SPEED=50, TIME=2000, NEXT` or `S=F2`.

    Return the internal speed in percent (None if not given), the minimum duration in ns, and whether the call
    returns before the motion ends. The unit of TIME, ms, is assumed. The names of the options come from two
    sources: Suzuki's VE026A_JNI.java, and ShoheiKobata/orin_bcap_python_samples. ACCEL and DECEL are checked
    but do not change the motion.
    """
    text = option[:LONGEST_POSE_TEXT].upper()
    given = {name: _option_number(value, read) for name, value in _OPTION.findall(text)}
    speed, time = given.get("SPEED", given.get("S")), given.pop("TIME", 0)
    if not 0 <= time <= LONGEST_TIME or not all(0 < share <= 100 for share in given.values()):
        raise RefusedError(E_INVALIDARG)
    return speed, round(time * MS), "NEXT" in text.replace(",", " ").split()


def _option_number(text: str, read: ReadVariable) -> float:
    variable = _VARIABLE.fullmatch(text)
    return number_of(read(variable[1], int(variable[2])) if variable else bstr(text))


def _running(context: CallContext, motion: TimedMove) -> RunningCall:
    machine, stops = context.machine, context.machine.stop_count

    def poll(now: int) -> CallResult | None:
        if machine.stop_count != stops:
            return CallResult(machine.stopped_by)
        return DONE if now >= motion.done_at else None

    return RunningCall(poll, lambda now: motion.done_at)


def _parse_passing(option: str) -> int:
    folded = option.upper()
    return END_OF_ENCODERS if "@E" in folded else PASSING if "@P" in folded else 0


def _before_position(joints: Joints, distance: float) -> Joints:
    """Move back from `joints` by `distance` mm along the approach vector."""
    here = position(joints)
    vector = trans(joints)[6:9]
    return joints_of_position((*(a - distance * b for a, b in zip(here, vector, strict=False)), *here[3:]))


def _distance(part: Variant) -> tuple[float, int]:
    """Read text such as `@P 10`, a number, or `[10, "", "@P"]` as a distance in mm and a pass motion."""
    if isinstance(part.value, str):
        last = part.value.split()[-1:] or ["0"]
        return float(number_of(bstr(last[0]))), _parse_passing(part.value)
    items = items_of(part)
    passing = next((parse_pass(item) for item in items[1:] if isinstance(item.value, str) and item.value), 0)
    return float(number_of(part)), passing


def _approach(context: CallContext) -> HandlerOutcome:
    """Parameters: interpolation, pose, distance and option."""
    items = context.items
    target = parse_target(items.at(1), context.machine.memory.read)
    distance, passing = _distance(items.at(2))
    goal = _before_position(target.joints, distance)
    return run_motion(context, MotionTarget(goal, passing), items.text(3, default=""))


def _depart(context: CallContext) -> HandlerOutcome:
    """Parameters: interpolation, distance and option."""
    items = context.items
    distance, passing = _distance(items.at(1))
    goal = _before_position(context.machine.arm.goal, distance)
    return run_motion(context, MotionTarget(goal, passing), items.text(2, default=""))


def _drive_many(context: CallContext, absolute: bool) -> HandlerOutcome:
    """Parameters: axes with their angles, as text or as pairs, then an option."""
    items = context.items
    ways, passing = _axis_moves(items.at(0))
    option = items.text(1, default="")
    passing = _parse_passing(option) if passing is None else passing
    return _drive_axes(context, ways, absolute, option, passing)


def _axis_moves_of_text(text: str) -> tuple[list[tuple[int, float]], int | None]:
    """Read axes with angles, and the pass motion, from text such as `@E (1, 5), (2, -10)`."""
    match = _AXES.fullmatch(text) if len(text) <= LONGEST_POSE_TEXT else None
    pairs = _PAIR.findall(match["pairs"]) if match else []
    if match is None or len(pairs) != match["pairs"].count("("):
        raise RefusedError(E_INVALIDARG)
    ways = [(int(axis), float(number_of(bstr(angle)))) for axis, angle in pairs]
    return ways, parse_pass_text(match["pass"]) if match["pass"] else None


def _axis_moves(axes: Variant) -> tuple[list[tuple[int, float]], int | None]:
    """Read text or an array of pairs `[axis, angle]`. Return the pairs, and the pass motion or None.

    DENSO's ROS driver replaces each pair with an array: the pair, a type and the pass motion.
    """
    if isinstance(axes.value, str):
        return _axis_moves_of_text(axes.value)
    ways, passing = [], None
    for parts in map(items_of, items_of(axes)):
        wrapped = isinstance(parts.at(0).value, tuple)
        pair = items_of(parts[0]) if wrapped else parts
        if wrapped and passing is None and len(parts) > 2:
            passing = parse_pass(parts[2])
        ways.append((pair.integer(0), pair.number(1)))
    return ways, passing


def _motion_skip(context: CallContext) -> None:
    """End the running motion where the arm is; the call of that motion succeeds."""
    machine, now = context.machine, context.now
    if machine.current_move and now < machine.free_at:
        machine.current_move.skip(now)


MOTION_COMMANDS: CommandTable = {
    "approach": _approach,
    "depart": _depart,
    "driveex": partial(_drive_many, absolute=False),
    "driveaex": partial(_drive_many, absolute=True),
    "motionskip": _motion_skip,
}
