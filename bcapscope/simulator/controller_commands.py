"""Commands of Controller_Execute and Task_Execute.

Names, parameters and results: ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2,
nkawa/Denso_CobottaPro900_MQTT_Control (bits of SysState, fields of an error).
"""

from __future__ import annotations

from datetime import datetime, timedelta
from types import MappingProxyType

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG, describe_hresult
from bcapscope.simulator.alarms import Alarm
from bcapscope.simulator.argument_values import boolean, bstr, i2, i4, integer_of, variant_array
from bcapscope.simulator.call_context import CallContext, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import DONE, CallOutcome, CallResult, RefusedError
from bcapscope.simulator.hand_commands import HAND_COMMANDS
from bcapscope.simulator.machine import AUTOMATIC, MANUAL, READY, RUNNING, Machine
from bcapscope.simulator.result_codes import BAD_INDEX, EMERGENCY_STOP

_DAY_0 = datetime(1899, 12, 30)


def clear_error(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run ClearError; refused while the emergency stop is pressed."""
    if context.machine.emergency:
        raise RefusedError(EMERGENCY_STOP)
    context.machine.clear_errors()
    return DONE


def error_description(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetErrorDescription; the text is bcapscope's, not the controller's."""
    return CallResult(value=bstr(describe_hresult(integer_of(parameter)).text))


def current_error_count(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetCurErrorCount."""
    return CallResult(value=i4(len(context.machine.alarms.active)))


def current_error_info(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetCurErrorInfo; index 0 is the newest."""
    alarm = _alarm_at(tuple(context.machine.alarms.active), integer_of(parameter))
    return CallResult(
        value=variant_array(i4(alarm.code), bstr(alarm.text), i4(0), i4(0), bstr(""), i4(0), i4(0))
    )


def error_log_count(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetErrorLogCount."""
    return CallResult(value=i4(len(context.machine.alarms.log)))


def error_log(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetErrorLog; index 0 is the newest."""
    alarm = _alarm_at(tuple(context.machine.alarms.log), integer_of(parameter))
    at = _DAY_0 + timedelta(days=context.machine.date(alarm.time))
    clock = (
        at.year,
        at.month,
        at.isoweekday() % 7,
        at.day,
        at.hour,
        at.minute,
        at.second,
        at.microsecond // 1000,
    )
    rest = (i4(0), i4(0), i4(0), bstr(alarm.text), i4(alarm.code), i4(0), bstr(""))
    return CallResult(value=variant_array(i4(alarm.code), *map(i4, clock), *rest))


def _alarm_at(alarms: tuple[Alarm, ...], index: int) -> Alarm:
    if not 0 <= index < len(alarms):
        raise RefusedError(BAD_INDEX)
    return alarms[index]


def system_info(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run SysInfo: the serial number for parameter 0, an empty text for others."""
    return CallResult(value=bstr("SIMULATOR" if integer_of(parameter) == 0 else ""))


def state_bits(machine: Machine, now: int) -> int:
    """Return the bits of SysState, as in `enumerations.SYS_STATE_BITS`."""
    automatic = machine.mode == AUTOMATIC
    bits = {
        0: RUNNING in machine.tasks.values(),
        1: bool(machine.alarms.active),
        2: machine.motor_is_on(now),
        3: True,
        4: automatic,
        5: automatic,
        10: machine.emergency,
        11: automatic,
        17: True,
        18: machine.mode == MANUAL,
        20: now < machine.arm.ends or not machine.slave.is_empty,
        21: not machine.arm.is_at_rest(now),
    }
    return sum(1 << bit for bit, value in bits.items() if value)


def system_state(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run SysState."""
    return CallResult(value=i4(state_bits(context.machine, context.now)))


def put_auto_mode(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run PutAutoMode (RC7): 1 is internal, 2 external."""
    mode = integer_of(parameter)
    if mode not in (1, 2):
        raise RefusedError(E_INVALIDARG)
    context.machine.auto_mode = mode
    return DONE


def get_auto_mode(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetAutoMode (RC7)."""
    return CallResult(value=i2(context.machine.auto_mode))


def task_status(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetStatus of a task."""
    return CallResult(value=i4(context.machine.tasks.get(context.object.name.casefold(), READY)))


CONTROLLER_COMMANDS: CommandTable = MappingProxyType(
    {
        **HAND_COMMANDS,
        "clearerror": clear_error,
        "geterrordescription": error_description,
        "getcurerrorcount": current_error_count,
        "getcurerrorinfo": current_error_info,
        "geterrorlogcount": error_log_count,
        "geterrorlog": error_log,
        "sysinfo": system_info,
        "sysstate": system_state,
        "stostate": lambda context, parameter: CallResult(value=boolean(context.machine.emergency)),
        "manualreset": accept_without_effect,
        "manualresetpreparation": accept_without_effect,
        "resetstostate": accept_without_effect,
        "putautomode": put_auto_mode,
        "getautomode": get_auto_mode,
    }
)
"""Commands of Controller_Execute by their names in lower case."""

TASK_COMMANDS: CommandTable = MappingProxyType({"getstatus": task_status})
"""Commands of Task_Execute by their names in lower case."""
