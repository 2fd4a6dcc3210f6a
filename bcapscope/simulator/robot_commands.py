"""Commands of Robot_Execute other than motions and slave mode.

Sources for names, parameters and results: ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2,
nkawa/Denso_CobottaPro900_MQTT_Control. Results that no source shows are inferred as in `commands.tsv`.
"""

from __future__ import annotations

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.tables.hresult import E_ARM_NOT_TAKEN, E_INVALIDARG
from bcapscope.simulator.argument_values import (
    argument_at,
    boolean,
    bstr,
    float_array,
    i4,
    integer_of,
    items_of,
    numbers_of,
    r8,
)
from bcapscope.simulator.arm import MS
from bcapscope.simulator.call_context import CallContext, CommandHandler, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import RefusedError, RunningCall, succeed_at
from bcapscope.simulator.control_log_ring import log_record_variant
from bcapscope.simulator.equipment_commands import EQUIPMENT_COMMANDS
from bcapscope.simulator.frame_commands import FRAME_COMMANDS
from bcapscope.simulator.hand_commands import GRIPPER_COMMANDS
from bcapscope.simulator.kinematics import pose_of
from bcapscope.simulator.motion_commands import MOTION_COMMANDS
from bcapscope.simulator.result_codes import BAD_INDEX
from bcapscope.simulator.slave_commands import SLAVE_COMMANDS, currents

_P, _J, _T = PoseType.P, PoseType.J, PoseType.T
_KEEP, _SQUARE = -1, -2


def _take_arm(context: CallContext, parameter: Variant) -> None:
    """Run TakeArm; refuse it while another client has the arm.

    Unless its second number is 1, TakeArm resets the internal speed, tool and work.
    """
    machine, items = context.machine, items_of(parameter)
    keeps = len(items) > 1 and integer_of(items[1]) == 1
    if machine.owner not in (None, context.client):
        raise RefusedError(E_ARM_NOT_TAKEN)
    machine.owner = context.client
    if not keeps:
        machine.speeds.internal = 100.0
        machine.tool = machine.work = 0


def _give_arm(context: CallContext, parameter: Variant) -> None:
    """Run GiveArm, which has no effect if another client has the arm."""
    if context.machine.owner == context.client:
        context.machine.owner = None


def motor(context: CallContext, parameter: Variant) -> RunningCall | None:
    """Run Motor, which lasts until the motor is on, unless the second number says not to wait."""
    items = items_of(parameter)
    on = integer_of(argument_at(items, 0)) != 0
    done = context.machine.switch_motor(on, context.now)
    waits = len(items) < 2 or integer_of(items[1]) == 0
    return succeed_at(done) if waits and done > context.now else None


def _ext_speed(context: CallContext, parameter: Variant) -> None:
    """Run ExtSpeed: speed, acceleration, deceleration in percent; -1 keeps a value, -2 is speed² / 100."""
    numbers = numbers_of(parameter)
    if not numbers:
        raise RefusedError(E_INVALIDARG)
    speeds = context.machine.speeds
    old = (speeds.external, speeds.external_acceleration, speeds.external_deceleration)
    speed = old[0] if numbers[0] == _KEEP else numbers[0]
    rest = [
        keep if value == _KEEP else speed * speed / 100 if value == _SQUARE else value
        for keep, value in zip(old[1:], (*numbers[1:3], *(_SQUARE,) * 2), strict=False)
    ]
    if not all(0 < value <= 100 for value in (speed, *rest)):
        raise RefusedError(E_INVALIDARG)
    speeds.external, speeds.external_acceleration, speeds.external_deceleration = speed, *rest


def _current_pose(pose_type: PoseType, timed: bool = False) -> CommandHandler:
    def run(context: CallContext, parameter: Variant) -> Variant:
        values = pose_of(pose_type, context.machine.arm.actual(context.now))
        time = ((context.now - context.machine.started_at) / MS,) if timed else ()
        return float_array(context.machine.profile.real, (*time, *values))

    return run


def _destination(context: CallContext, parameter: Variant) -> Variant:
    return float_array(context.machine.profile.real, pose_of(_P, context.machine.arm.goal))


def _motion_complete(context: CallContext, parameter: Variant) -> Variant:
    """Run MotionComplete for the commanded motion; a second number 1 means that of the encoders."""
    items = items_of(parameter)
    if len(items) > 1 and integer_of(items[1]) == 1:
        return boolean(context.machine.arm.is_at_rest(context.now))
    return boolean(context.now >= context.machine.free_at)


def _servo_data(context: CallContext, parameter: Variant) -> Variant:
    """Run GetSrvData, which returns the lag of the encoders in degrees for any number as parameter."""
    integer_of(parameter)
    return float_array(VT.R8, currents(context))


def _log_record(context: CallContext, parameter: Variant) -> Variant:
    """Run GetLogRecord, for which index 0 is the oldest record."""
    index, machine = integer_of(parameter), context.machine
    if not 0 <= index < len(machine.log.records):
        raise RefusedError(BAD_INDEX)
    return log_record_variant(machine.log.records[index], machine.tool, machine.work)


def _current_speed(name: str) -> CommandHandler:
    return lambda context, _: r8(getattr(context.machine.speeds, name))


ROBOT_COMMANDS: CommandTable = {
    **SLAVE_COMMANDS,
    **MOTION_COMMANDS,
    **FRAME_COMMANDS,
    **GRIPPER_COMMANDS,
    **EQUIPMENT_COMMANDS,
    "takearm": _take_arm,
    "givearm": _give_arm,
    "takearmstate": lambda context, _: i4(int(context.machine.owner == context.client)),
    "motor": motor,
    "extspeed": _ext_speed,
    "curpos": _current_pose(_P),
    "curposex": _current_pose(_P, timed=True),
    "curjnt": _current_pose(_J),
    "curtrn": _current_pose(_T),
    "highcurjntex": _current_pose(_J, timed=True),
    "destpos": _destination,
    "curspd": _current_speed("internal"),
    "curacc": _current_speed("acceleration"),
    "curextspd": _current_speed("external"),
    "curextacc": _current_speed("external_acceleration"),
    "curtool": lambda context, _: i4(context.machine.tool),
    "motioncomplete": _motion_complete,
    "getsrvdata": _servo_data,
    "getrobottypename": lambda context, _: bstr(context.machine.initial_state.type_name),
    "clearlog": lambda context, _: context.machine.log.records.clear(),
    "startlog": lambda context, _: context.machine.log.start(context.now),
    "stoplog": lambda context, _: context.machine.log.stop(),
    "getlogcount": lambda context, _: i4(len(context.machine.log.records)),
    "getlogrecord": _log_record,
    "payload": accept_without_effect,
    "speedmode": accept_without_effect,
    "highpathaccuracy": accept_without_effect,
    "grvoffset": accept_without_effect,
    "manualresetpreparation": accept_without_effect,
    "motionpreparation": accept_without_effect,
    "getmotionpreparationstate": lambda context, _: boolean(True),
}
"""Handlers of the commands of Robot_Execute by the commands' names in lower case."""
