"""The commands of slave mode: slvChangeMode, slvGetMode, slvMove, slvSendFormat and slvRecvFormat."""

from __future__ import annotations

from math import hypot

from bcapscope.protocol.codec.variant import ARRAY, VT, Variant, integer_value
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat, parse_format_parameter
from bcapscope.protocol.slave_mode.modes import PoseType, SlaveMode, slave_mode_by_number
from bcapscope.protocol.slave_mode.slvmove_values import SetPoint, UserIO, parse_set_point
from bcapscope.protocol.tables.hresult import (
    E_INVALIDARG,
    E_NOT_IN_SLAVE_MODE,
    E_REFUSED_IN_SLAVE_MODE,
    S_BUF_FULL,
    S_OK,
)
from bcapscope.simulator.argument_values import float_array, i2, i4, variant_array
from bcapscope.simulator.arm import MS
from bcapscope.simulator.call_context import CallContext, CommandTable
from bcapscope.simulator.call_outcome import (
    DONE,
    CallOutcome,
    CallResult,
    HandlerOutcome,
    RefusalCode,
    RefusedError,
    RunningCall,
)
from bcapscope.simulator.kinematics import POSE_LENGTHS, Joints, axis_beyond_limit, joints_of, pose_of
from bcapscope.simulator.variable_memory import IO_BYTES

PATIENCE = 500 * MS
"""Longest time in ns that slvChangeMode waits until the robot stands still (DENSO Wave 2009)."""

INVALID_SET_POINT = 0x83201405
LONGEST_SET_POINT = 1e9
"""A set point is invalid if the square root of the sum of its squared numbers is not below this value."""

FIRST_USER_IO = 128
HAND_IO, MINI_IO = 48, 0


def change_mode(context: CallContext) -> HandlerOutcome:
    value = integer_value(context.parameter)
    mode = None if value is None else slave_mode_by_number(value, context.machine.profile.generation)
    if mode is None:
        raise RefusedError(E_INVALIDARG)
    if mode.pose_type is None:
        return _leave(context)
    if context.machine.slave.mode is not None:
        context.machine.refuse(E_REFUSED_IN_SLAVE_MODE, context.now)
    context.machine.check_slave_mode(context.client, context.now)
    return _enter(context, mode)


def _enter(context: CallContext, mode: SlaveMode) -> CallOutcome:
    machine, began, stops = context.machine, context.now, context.machine.stop_count

    def poll(now: int) -> CallResult | None:
        if machine.stop_count != stops:
            return CallResult(machine.stopped_by)
        if machine.arm.is_at_rest(now) and not machine.is_held:
            machine.slave.enter(mode, now)
            return DONE
        return CallResult(machine.profile.running_result) if now >= began + PATIENCE else None

    def due(now: int) -> int:
        settles, end = machine.arm.at_rest_from, began + PATIENCE
        return min(settles, end) if settles > now else end

    return poll(began) or RunningCall(poll, due)


def _leave(context: CallContext) -> RunningCall | None:
    machine = context.machine
    slave, run = machine.slave, machine.slave.run_number
    if slave.mode is None:
        slave.unreported_result = 0
        return None
    slave.drain()

    def poll(now: int) -> CallResult | None:
        if slave.run_number != run:
            return DONE
        if slave.mode is None:
            # this reply reports the end of slave mode, so slvMove need not report it
            slave.unreported_result = 0
            return DONE
        if not slave.is_empty or not machine.arm.is_at_rest(now):
            return None
        slave.leave()
        return DONE

    return RunningCall(
        poll, lambda now: max(slave.next_tick if not slave.is_empty else machine.arm.at_rest_from, now)
    )


def get_mode(context: CallContext) -> Variant:
    mode = context.machine.slave.mode
    value = mode.value if mode else 0
    return i2(value) if context.machine.profile.mode_type == VT.I2 else i4(value)


def send_format(context: CallContext) -> None:
    found = parse_format_parameter(context.parameter)
    form = SendFormat.parse(found.value) if found else None
    if form is None or not form.is_known:
        raise RefusedError(E_INVALIDARG)
    context.machine.slave.send_format = form


def receive_format(context: CallContext) -> None:
    found = parse_format_parameter(context.parameter)
    form = ReceiveFormat.parse(found.value, found.microseconds) if found else None
    if form is None or not form.is_known:
        raise RefusedError(E_INVALIDARG)
    context.machine.slave.receive_format = form


def slave_move(context: CallContext) -> CallOutcome:
    machine, slave = context.machine, context.machine.slave
    mode = slave.mode
    if mode is None or mode.pose_type is None:
        owed, slave.unreported_result = slave.unreported_result, 0
        if owed:
            raise RefusedError(owed)
        machine.refuse(E_NOT_IN_SLAVE_MODE, context.now)
    machine.check_arm(context.client)
    point = parse_set_point(context.parameter, mode.pose_type, slave.send_format, slave.receive_format)
    joints = _joints(context, mode.pose_type, point)
    needed = slave.push(joints)
    _write_io(context, point)
    if not mode.paces_client:
        full = mode.overflow_is_error and slave.waiting >= mode.buffer_slots
        return CallResult(S_BUF_FULL if full else S_OK, _feedback(context, mode.pose_type, point))
    return _pace(context, mode.pose_type, point, needed)


def _pace(context: CallContext, pose_type: PoseType, point: SetPoint, needed: int) -> CallOutcome:
    machine, slave, run = context.machine, context.machine.slave, context.machine.slave.run_number

    def poll(now: int) -> CallResult | None:
        if slave.run_number != run or (slave.mode is None and slave.consumed < needed):
            slave.unreported_result = 0
            return CallResult(machine.stopped_by or E_NOT_IN_SLAVE_MODE)
        if slave.consumed < needed:
            return None
        context.now = now
        return CallResult(value=_feedback(context, pose_type, point))

    return poll(context.now) or RunningCall(poll, lambda now: slave.next_tick)


def _joints(context: CallContext, pose_type: PoseType, point: SetPoint) -> Joints:
    """Return the joints of a set point, or refuse it; an impossible set point also ends slave mode."""
    if point.problems or point.pose is None:
        raise RefusedError(E_INVALIDARG)
    values = point.pose.values
    if len(values) + len(point.pose.extra) not in POSE_LENGTHS[pose_type]:
        raise RefusedError(E_INVALIDARG)
    try:
        if not hypot(*values) < LONGEST_SET_POINT:  # `not <` is also true if a number is NaN
            raise RefusedError(INVALID_SET_POINT)
        joints = joints_of(pose_type, values)
        axis = axis_beyond_limit(joints, context.machine.initial_state.limits)
        if axis:
            raise RefusedError(RefusalCode.POSITION_LIMIT + axis)
    except RefusedError as refusal:
        context.machine.raise_error(refusal.hresult, context.now, is_reported=True)
        raise
    return joints


def _write_io(context: CallContext, point: SetPoint) -> None:
    memory = context.machine.memory
    if point.mini_io is not None:
        memory.io[3] = point.mini_io >> 24 & 0xFF  # IO24 to IO31; all other bits are ignored
    if point.hand_io is not None:
        memory.io[8] = point.hand_io >> 16 & 0xFF  # IO64 to IO71
    if point.user_write is not None and point.user_write.data is not None:
        start, stop = _run(point.user_write)
        memory.io[start:stop] = point.user_write.data[: stop - start].ljust(stop - start, b"\0")


def _run(run: UserIO) -> tuple[int, int]:
    start, size = run.offset // 8, run.size // 8
    if run.offset < FIRST_USER_IO or run.offset % 8 or run.size % 8 or not 0 < size <= IO_BYTES - start:
        raise RefusedError(E_INVALIDARG)
    return start, start + size


def _feedback(context: CallContext, pose_type: PoseType, point: SetPoint) -> Variant:
    machine = context.machine
    actual = machine.arm.actual(context.now)
    form = machine.slave.receive_format
    if form is None:
        return _pose(context, pose_type, actual)
    if form.bare_pose_type:
        return _pose(context, form.bare_pose_type, actual)
    parts = []
    if form.timestamp:
        parts.append(i4((context.now - machine.started_at) // (1000 if form.microseconds else MS)))
    if form.poses:
        parts.append(float_array(VT.R8, [value for each in form.poses for value in pose_of(each, actual)]))
    if form.mini_io:
        parts.append(machine.memory.read("IOD", MINI_IO))
    if form.user_io:
        start, stop = _run(point.user_read) if point.user_read else (0, 0)
        parts.append(Variant.array(VT.UI1, bytes(machine.memory.io[start:stop])))
    if form.hand_io:
        parts.append(machine.memory.read("IOD", HAND_IO))
    if form.current:
        parts.append(float_array(VT.R8, currents(context)))
    return variant_array(*parts)


def _pose(context: CallContext, pose_type: PoseType, joints: Joints) -> Variant:
    pose = pose_of(pose_type, joints)
    return Variant(ARRAY | context.machine.profile.real, pose, len(pose))


def currents(context: CallContext) -> tuple[float, ...]:
    """Return one number per axis in place of the motor current, which the simulator does not compute. The
    number is the difference between the commanded and the measured angle in degrees.
    """
    arm, now = context.machine.arm, context.now
    return tuple(a - b for a, b in zip(arm.commanded(now), arm.actual(now), strict=True))


SLAVE_COMMANDS: CommandTable = {
    "slvchangemode": change_mode,
    "slvgetmode": get_mode,
    "slvmove": slave_move,
    "slvsendformat": send_format,
    "slvrecvformat": receive_format,
}
