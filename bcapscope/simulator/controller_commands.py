"""Commands of Controller_Execute and Task_Execute.

Names, parameters and results: ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2,
nkawa/Denso_CobottaPro900_MQTT_Control (bits of SysState, fields of an error). Fields of an error that only a
real controller program can fill are 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG, describe_hresult
from bcapscope.simulator.argument_values import boolean, bstr, i2, i4, integer_of, variant_array
from bcapscope.simulator.call_context import CallContext, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import RefusedError
from bcapscope.simulator.equipment_commands import HAND_COMMANDS
from bcapscope.simulator.machine import AUTOMATIC, MANUAL, READY, RUNNING, Alarm
from bcapscope.simulator.result_codes import BAD_INDEX, EMERGENCY_STOP

_DAY_0 = datetime(1899, 12, 30)


def _clear_error(context: CallContext, parameter: Variant) -> None:
    if context.machine.emergency:
        raise RefusedError(EMERGENCY_STOP)
    context.machine.clear_errors()


def _current_error_info(context: CallContext, parameter: Variant) -> Variant:
    alarm = _alarm_at(context.machine.alarms.active, integer_of(parameter))
    return variant_array(i4(alarm.code), bstr(alarm.text), i4(0), i4(0), bstr(""), i4(0), i4(0))


def _error_log(context: CallContext, parameter: Variant) -> Variant:
    alarm = _alarm_at(context.machine.alarms.log, integer_of(parameter))
    at = _DAY_0 + timedelta(days=context.machine.date(alarm.time))
    date = (at.year, at.month, at.isoweekday() % 7, at.day)
    clock = (at.hour, at.minute, at.second, at.microsecond // 1000)
    rest = (i4(0), i4(0), i4(0), bstr(alarm.text), i4(alarm.code), i4(0), bstr(""))
    return variant_array(i4(alarm.code), *map(i4, (*date, *clock)), *rest)


def _alarm_at(alarms: Sequence[Alarm], index: int) -> Alarm:
    """Return an error by its index; index 0 is the newest error."""
    if not 0 <= index < len(alarms):
        raise RefusedError(BAD_INDEX)
    return alarms[index]


def _system_state(context: CallContext, parameter: Variant) -> Variant:
    """Run SysState, whose bits are those of `enumerations.SYS_STATE_BITS`."""
    machine, now = context.machine, context.now
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
    return i4(sum(1 << bit for bit, value in bits.items() if value))


def _put_auto_mode(context: CallContext, parameter: Variant) -> None:
    """Run PutAutoMode of RC7, whose parameter is 1 for internal and 2 for external."""
    mode = integer_of(parameter)
    if mode not in (1, 2):
        raise RefusedError(E_INVALIDARG)
    context.machine.auto_mode = mode


CONTROLLER_COMMANDS: CommandTable = {
    **HAND_COMMANDS,
    "clearerror": _clear_error,
    # The text of an error is bcapscope's, not the controller's.
    "geterrordescription": lambda context, code: bstr(describe_hresult(integer_of(code)).text),
    "getcurerrorcount": lambda context, _: i4(len(context.machine.alarms.active)),
    "getcurerrorinfo": _current_error_info,
    "geterrorlogcount": lambda context, _: i4(len(context.machine.alarms.log)),
    "geterrorlog": _error_log,
    # SysInfo returns the serial number for 0, and an empty text for other numbers.
    "sysinfo": lambda context, kind: bstr("" if integer_of(kind) else "SIMULATOR"),
    "sysstate": _system_state,
    "stostate": lambda context, _: boolean(context.machine.emergency),
    "manualreset": accept_without_effect,
    "manualresetpreparation": accept_without_effect,
    "resetstostate": accept_without_effect,
    "putautomode": _put_auto_mode,
    "getautomode": lambda context, _: i2(context.machine.auto_mode),
}
"""Handlers of the commands of Controller_Execute by the commands' names in lower case."""

TASK_COMMANDS: CommandTable = {
    "getstatus": lambda context, _: i4(context.machine.tasks.get(context.object.name.casefold(), READY))
}
"""Handlers of the commands of Task_Execute by the commands' names in lower case."""
