"""Commands of Robot_Execute that are neither motions nor of slave mode.

Names, parameters and results: ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2,
nkawa/Denso_CobottaPro900_MQTT_Control. Results that no source printed are as `command_table` infers them.
"""

from __future__ import annotations

from types import MappingProxyType

from bcapscope.protocol.hresult import E_ARM_NOT_TAKEN, E_INVALIDARG
from bcapscope.protocol.slavemode import PoseType
from bcapscope.protocol.variant import VT, Variant
from bcapscope.simulator.arm import MS
from bcapscope.simulator.context import Command, Commands, Context, accepted
from bcapscope.simulator.controllog import record_values
from bcapscope.simulator.equipmentcommands import EQUIPMENT_COMMANDS
from bcapscope.simulator.framecommands import FRAME_COMMANDS
from bcapscope.simulator.handcommands import GRIPPER_COMMANDS
from bcapscope.simulator.kinematics import pose_of
from bcapscope.simulator.motions import MOTION_COMMANDS
from bcapscope.simulator.outcome import DONE, Answer, Outcome, RefusedError, answer_at
from bcapscope.simulator.refusals import BAD_INDEX
from bcapscope.simulator.slavecommands import SLAVE_COMMANDS, currents
from bcapscope.simulator.values import (
    boolean,
    bstr,
    i4,
    integer_of,
    items_of,
    nth,
    numbers_of,
    r8,
    row,
)

_P, _J, _T = PoseType.P, PoseType.J, PoseType.T
_KEEP, _SQUARE = -1, -2


def take_arm(context: Context, parameter: Variant) -> Outcome:
    """Run TakeArm: refused while another client has the arm; sets the internal speed, tool and work back
    unless the second number is 1.
    """
    machine, items = context.machine, items_of(parameter)
    keeps = len(items) > 1 and integer_of(items[1]) == 1
    if machine.owner not in (None, context.client):
        raise RefusedError(E_ARM_NOT_TAKEN)
    machine.owner = context.client
    if not keeps:
        machine.speeds.internal = 100.0
        machine.tool = machine.work = 0
    return DONE


def give_arm(context: Context, parameter: Variant) -> Outcome:
    """Run GiveArm: nothing happens where the arm is not this client's."""
    if context.machine.owner == context.client:
        context.machine.owner = None
    return DONE


def take_arm_state(context: Context, parameter: Variant) -> Outcome:
    """Run TakeArmState."""
    return Answer(value=i4(int(context.machine.owner == context.client)))


def motor(context: Context, parameter: Variant) -> Outcome:
    """Run Motor; the call lasts until the motor is on unless the second number says not to wait."""
    items = items_of(parameter)
    on = integer_of(nth(items, 0)) != 0
    done = context.machine.switch_motor(on, context.now)
    waits = len(items) < 2 or integer_of(items[1]) == 0
    return answer_at(done) if waits and done > context.now else DONE


def ext_speed(context: Context, parameter: Variant) -> Outcome:
    """Run ExtSpeed: speed, acceleration, deceleration in percent; -1 keeps, -2 is speed squared / 100."""
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
    return DONE


def _now(pose_type: PoseType, timed: bool = False) -> Command:
    def run(context: Context, parameter: Variant) -> Outcome:
        values = pose_of(pose_type, context.machine.arm.actual(context.now))
        time = ((context.now - context.machine.began) / MS,) if timed else ()
        return Answer(value=row(context.machine.profile.real, (*time, *values)))

    return run


def destination(context: Context, parameter: Variant) -> Outcome:
    """Run DestPos."""
    return Answer(value=row(context.machine.profile.real, pose_of(_P, context.machine.arm.goal)))


def motion_complete(context: Context, parameter: Variant) -> Outcome:
    """Run MotionComplete: by the command, or by the encoders where the second number is 1."""
    items = items_of(parameter)
    by_encoders = len(items) > 1 and integer_of(items[1]) == 1
    machine = context.machine
    done = machine.arm.stands(context.now) if by_encoders else context.now >= machine.free_at
    return Answer(value=boolean(done))


def servo_data(context: Context, parameter: Variant) -> Outcome:
    """Run GetSrvData: the deviation of the encoders for 2, else a number of the same size."""
    integer_of(parameter)
    return Answer(value=row(VT.R8, currents(context)))


def log_count(context: Context, parameter: Variant) -> Outcome:
    """Run GetLogCount."""
    return Answer(value=i4(len(context.machine.log.records)))


def log_record(context: Context, parameter: Variant) -> Outcome:
    """Run GetLogRecord; index 0 is the oldest."""
    index, machine = integer_of(parameter), context.machine
    if not 0 <= index < len(machine.log.records):
        raise RefusedError(BAD_INDEX)
    record = machine.log.records[index]
    lag = tuple(a - b for a, b in zip(record.commanded, record.actual, strict=True))
    return Answer(value=record_values(record, lag, machine.tool, machine.work))


def clear_log(context: Context, parameter: Variant) -> Outcome:
    """Run ClearLog."""
    context.machine.log.records.clear()
    return DONE


def start_log(context: Context, parameter: Variant) -> Outcome:
    """Run StartLog."""
    context.machine.log.start(context.now)
    return DONE


def stop_log(context: Context, parameter: Variant) -> Outcome:
    """Run StopLog."""
    context.machine.log.stop()
    return DONE


def type_name(context: Context, parameter: Variant) -> Outcome:
    """Run GetRobotTypeName."""
    return Answer(value=bstr(context.machine.start.type_name))


def _speed(name: str) -> Command:
    return lambda context, parameter: Answer(value=r8(getattr(context.machine.speeds, name)))


ROBOT_COMMANDS: Commands = MappingProxyType(
    {
        **SLAVE_COMMANDS,
        **MOTION_COMMANDS,
        **FRAME_COMMANDS,
        **GRIPPER_COMMANDS,
        **EQUIPMENT_COMMANDS,
        "takearm": take_arm,
        "givearm": give_arm,
        "takearmstate": take_arm_state,
        "motor": motor,
        "extspeed": ext_speed,
        "curpos": _now(_P),
        "curposex": _now(_P, timed=True),
        "curjnt": _now(_J),
        "curtrn": _now(_T),
        "highcurjntex": _now(_J, timed=True),
        "destpos": destination,
        "curspd": _speed("internal"),
        "curacc": _speed("acceleration"),
        "curextspd": _speed("external"),
        "curextacc": _speed("external_acceleration"),
        "curtool": lambda context, parameter: Answer(value=i4(context.machine.tool)),
        "motioncomplete": motion_complete,
        "getsrvdata": servo_data,
        "getrobottypename": type_name,
        "clearlog": clear_log,
        "startlog": start_log,
        "stoplog": stop_log,
        "getlogcount": log_count,
        "getlogrecord": log_record,
        "payload": accepted,
        "speedmode": accepted,
        "highpathaccuracy": accepted,
        "grvoffset": accepted,
        "manualresetpreparation": accepted,
        "motionpreparation": accepted,
        "getmotionpreparationstate": lambda context, parameter: Answer(value=boolean(True)),
    }
)
"""Commands of Robot_Execute by their names in lower case."""
