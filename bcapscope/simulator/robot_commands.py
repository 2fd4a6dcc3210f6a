"""Commands of the extension Pallet, and those of Robot_Execute except motions, slave mode and equipment."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import permutations

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.protocol.tables.hresult import E_ARM_NOT_TAKEN, E_INVALIDARG
from bcapscope.simulator.argument_values import (
    boolean,
    bstr,
    float_array,
    i4,
    integer_of,
    number_within,
    numbers_of,
    r8,
    variant_array,
)
from bcapscope.simulator.arm import MS
from bcapscope.simulator.call_context import CallContext, CallHandler, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import DONE, RefusalCode, RefusedError, RunningCall
from bcapscope.simulator.equipment_commands import EQUIPMENT_COMMANDS
from bcapscope.simulator.kinematics import (
    FIG,
    Joints,
    PoseNumbers,
    joints_of,
    moved_in_base,
    moved_in_tool,
    pose_of,
    relative_to,
)
from bcapscope.simulator.motion_commands import MOTION_COMMANDS
from bcapscope.simulator.pose_notation import parse_pose, parse_target
from bcapscope.simulator.slave_commands import SLAVE_COMMANDS, currents
from bcapscope.simulator.variable_memory import check_index

_P, _J, _T = PoseType.P, PoseType.J, PoseType.T
_UNREACHABLE = -1
_MAX_PLACES = 32767
"""Maximum number of rows, columns and layers of a pallet; the limit is assumed."""


def _convert(context: CallContext, source: PoseType, target: PoseType) -> Variant:
    return context.real_array(pose_of(target, _joints(context, source)))


def _joints(context: CallContext, pose_type: PoseType) -> Joints:
    """Read a pose. If the notation gives no pose type, the pose has the type `pose_type` of the command."""
    items = context.items
    if len(items) >= len(AXES[_P]) - 1 and all(isinstance(item.value, int | float) for item in items):
        return joints_of(pose_type, numbers_of(context.parameter)[: len(AXES[pose_type])])
    return parse_target(context.parameter, context.machine.memory.read).joints


def _out_range(context: CallContext) -> Variant:
    """Return one bit for each axis beyond its limits, or -1 for a position out of reach."""
    items = context.items
    pose = items[0] if items and not isinstance(items[0].value, int | float) else context.parameter
    try:
        joints = parse_target(pose, context.machine.memory.read).joints
    except RefusedError as refusal:
        if refusal.hresult == E_INVALIDARG:
            raise
        return i4(_UNREACHABLE)
    limits = context.machine.initial_state.limits
    beyond = (not limit.low <= joint <= limit.high for joint, limit in zip(joints, limits, strict=False))
    return i4(sum(is_beyond << index for index, is_beyond in enumerate(beyond)))


def _check_virtual_fence(context: CallContext) -> Variant:
    """Return 0, because the simulated robot has no fences."""
    parse_pose(context.parameter, context.machine.memory.read)
    return i4(0)


def _move(context: CallContext, move: Callable[[PoseNumbers, PoseNumbers], PoseNumbers]) -> Variant:
    items = context.items
    if len(items) != 2:
        raise RefusedError(E_INVALIDARG)
    base, deviation = (_parse_position(context, item) for item in items)
    return context.real_array((*move(base, deviation), _fig(base)))


def _convert_work(context: CallContext) -> Variant:
    items, read = context.items, context.machine.memory.read
    pose = _parse_position(context, items.at(0))
    source, target = (numbers_of(read("WORK", items.integer(index))) for index in (1, 2))
    return context.real_array((*relative_to(target, moved_in_tool(source, pose)), _fig(pose)))


def _define(context: CallContext, kind: str) -> None:
    items = context.items
    context.machine.check_arm(context.client)
    number = items.integer(0)
    check_index(kind, number, is_write=True)
    frame = _parse_position(context, items.at(1))[:6]
    context.machine.memory.write(kind, number, float_array(VT.R8, frame))


def _parse_position(context: CallContext, pose: Variant) -> PoseNumbers:
    """Convert a pose of any type to P type. A pose that the client wrote as P type may be out of reach."""
    written = parse_pose(pose, context.machine.memory.read)
    return written.values if written.type is _P else pose_of(_P, joints_of(written.type, written.values))


def _fig(pose: PoseNumbers) -> float:
    return pose[6] if len(pose) > 6 else FIG


def _pallet_position(context: CallContext) -> Variant:
    """Parameters: rows, columns, layer height [mm], four corners, position and layer, both counted from 1."""
    items = context.items
    rows, columns = (_count(items.at(index)) for index in (0, 1))
    height = items.number(2)
    corners = [_parse_position(context, items.at(index)) for index in (3, 4, 5, 6)]
    place = _count(items.at(7)) - 1
    layer = _count(items[8]) - 1 if len(items) > 8 else 0
    if place >= rows * columns:
        raise RefusedError(RefusalCode.BAD_INDEX)
    down, across = _fraction(place // columns, rows), _fraction(place % columns, columns)
    near = _interpolate(corners[0], corners[1], across)
    far = _interpolate(corners[2], corners[3], across)
    x, y, z = _interpolate(near, far, down)
    first = corners[0]
    return context.real_array((x, y, z + height * layer, *first[3:6], _fig(first)))


def _count(part: Variant) -> int:
    return number_within(part, range(1, _MAX_PLACES + 1), E_INVALIDARG)


def _fraction(index: int, count: int) -> float:
    return index / (count - 1) if count > 1 else 0.0


def _interpolate(one: PoseNumbers, other: PoseNumbers, share: float) -> PoseNumbers:
    return tuple(a + (b - a) * share for a, b in zip(one[:3], other[:3], strict=True))


PALLET_COMMANDS: CommandTable = {"calcpos": _pallet_position}


_KEEP, _SQUARE = -1, -2


def _take_arm(context: CallContext) -> None:
    """Take the arm. If the second parameter is 1, TakeArm keeps speed, tool and work coordinates."""
    machine = context.machine
    keeps = context.items.integer(1, default=0) == 1
    if machine.owner not in (None, context.client):
        raise RefusedError(E_ARM_NOT_TAKEN)
    machine.owner = context.client
    if not keeps:
        machine.speeds.internal = 100.0
        machine.tool = machine.work = 0


def _give_arm(context: CallContext) -> None:
    if context.machine.owner == context.client:
        context.machine.owner = None


def motor(context: CallContext) -> RunningCall | None:
    """Switch the motor. If the second parameter is 0 or missing, the call lasts until the motor is on."""
    items = context.items
    done = context.machine.switch_motor(items.integer(0) != 0, context.now)
    waits = items.integer(1, default=0) == 0
    if not waits or done <= context.now:
        return None
    return RunningCall(lambda now: DONE if now >= done else None, lambda now: done)


def _ext_speed(context: CallContext) -> None:
    """Parameters: speed, acceleration and deceleration in percent; -1 keeps the current value. An
    acceleration or deceleration of -2 means speed² / 100.
    """
    numbers = numbers_of(context.parameter)
    if not numbers:
        raise RefusedError(E_INVALIDARG)
    speeds = context.machine.speeds
    old = (speeds.external, speeds.external_acceleration, speeds.external_deceleration)
    speed = old[0] if numbers[0] == _KEEP else numbers[0]
    rest = [
        keep if value == _KEEP else speed * speed / 100 if value == _SQUARE else value
        for keep, value in zip(old[1:], (*numbers[1:3], *(_SQUARE,) * 2), strict=False)
    ]
    speeds.set_percent(
        E_INVALIDARG, external=speed, external_acceleration=rest[0], external_deceleration=rest[1]
    )


def _timed_pose(context: CallContext, pose_type: PoseType) -> Variant:
    """Return the controller's time in ms, followed by the pose."""
    time = (context.now - context.machine.started_at) / MS
    return context.real_array((time, *pose_of(pose_type, context.joints)))


def _motion_complete(context: CallContext) -> Variant:
    """If the second parameter is 1, return whether the encoders are at rest. Otherwise, return whether the
    motion command has ended.
    """
    if context.items.integer(1, default=0) == 1:
        return boolean(context.machine.arm.is_at_rest(context.now))
    return boolean(context.now >= context.machine.free_at)


def _servo_data(context: CallContext) -> Variant:
    """Return by how many degrees the encoder of each axis lags. On a real controller, the number that the
    client sends selects other data, such as 4 for the torque. The simulator ignores this number.
    """
    integer_of(context.parameter)
    return float_array(VT.R8, currents(context))


def _log_record(context: CallContext) -> Variant:
    """Return a record of the control log; the parameter 0 selects the oldest record."""
    machine, records, values = context.machine, context.machine.log.records, []
    index = number_within(context.parameter, range(len(records)), RefusalCode.BAD_INDEX)
    time, all_commanded, all_actual = records[index]
    for commanded, actual in zip(all_commanded, all_actual, strict=True):
        lag = commanded - actual
        values += [r8(commanded), r8(actual), r8(lag), r8(abs(lag) * 10)]
    program = i4(0), i4(0), bstr(""), i4(0)
    return variant_array(*values, *program, i4(time // MS), i4(machine.tool), i4(machine.work))


def _current_speed(name: str) -> CallHandler:
    return lambda context: r8(getattr(context.machine.speeds, name))


ROBOT_COMMANDS: CommandTable = {
    **SLAVE_COMMANDS,
    **MOTION_COMMANDS,
    **EQUIPMENT_COMMANDS,
    **{
        f"{source}2{target}".lower(): partial(_convert, source=source, target=target)
        for source, target in permutations(PoseType, 2)
    },
    "outrange": _out_range,
    "checkvirtualfence": _check_virtual_fence,
    "dev": partial(_move, move=moved_in_base),
    "devh": partial(_move, move=moved_in_tool),
    "convertposwork": _convert_work,
    "gettooldef": lambda context: context.machine.memory.read("TOOL", integer_of(context.parameter)),
    "settooldef": partial(_define, kind="TOOL"),
    "setworkdef": partial(_define, kind="WORK"),
    "takearm": _take_arm,
    "givearm": _give_arm,
    "takearmstate": lambda context: i4(int(context.machine.owner == context.client)),
    "motor": motor,
    "extspeed": _ext_speed,
    "curpos": lambda context: context.current_pose(_P),
    "curposex": partial(_timed_pose, pose_type=_P),
    "curjnt": lambda context: context.current_pose(_J),
    "curtrn": lambda context: context.current_pose(_T),
    "highcurjntex": partial(_timed_pose, pose_type=_J),
    "destpos": lambda context: context.real_array(pose_of(_P, context.machine.arm.goal)),
    "curspd": _current_speed("internal"),
    "curacc": _current_speed("acceleration"),
    "curextspd": _current_speed("external"),
    "curextacc": _current_speed("external_acceleration"),
    "curtool": lambda context: i4(context.machine.tool),
    "motioncomplete": _motion_complete,
    "getsrvdata": _servo_data,
    "getrobottypename": lambda context: bstr(context.machine.initial_state.type_name),
    "clearlog": lambda context: context.machine.log.records.clear(),
    "startlog": lambda context: context.machine.log.start(context.now),
    "stoplog": lambda context: context.machine.log.stop(),
    "getlogcount": lambda context: i4(len(context.machine.log.records)),
    "getlogrecord": _log_record,
    **dict.fromkeys(("payload", "speedmode", "highpathaccuracy", "grvoffset"), accept_without_effect),
    **dict.fromkeys(("manualresetpreparation", "motionpreparation"), accept_without_effect),
    "getmotionpreparationstate": lambda context: boolean(True),
}
