"""Meanings of numbers, bits and strings in arguments and results of b-CAP calls.

Sources: ShoheiKobata/orin_bcap_python_samples and its documentation; bits of SysState and axis -1 from
nkawa/Denso_CobottaPro900_MQTT_Control; provider names from both and from DENSORobot/denso_robot_ros2.
"""

from __future__ import annotations

from collections.abc import Mapping

INTERPOLATIONS: Mapping[int, str] = {1: "P (PTP)", 2: "L (linear)", 3: "C (circular)", 4: "S (free curve)"}
"""lComp of Robot_Move."""

POSE_TYPES: Mapping[int, str] = {-1: "none", 0: "P", 1: "T", 2: "J", 3: "V"}
"""Pose type, the second element of a pose that is a VARIANT array. Controllers also accept the letter as
text."""

PASS_MOTIONS: Mapping[int, str] = {0: "@0", -1: "@P", -2: "@E"}
"""Pass motion, the third element of a pose that is a VARIANT array. Any other number n means @n. Controllers
also accept the text.
"""

TASK_START_MODES: Mapping[int, str] = {1: "one cycle", 2: "continuous", 3: "step"}
"""lMode of Task_Start."""

TASK_STOP_MODES: Mapping[int, str] = {0: "default", 1: "instant", 2: "step", 3: "cycle", 4: "initialise"}
"""lMode of Task_Stop."""

TASK_STATES: Mapping[int, str] = {0: "none", 1: "suspended", 2: "ready", 3: "running", 4: "step stop"}
"""Result of Task_Execute GetStatus."""

AUTO_MODES: Mapping[int, str] = {1: "internal automatic", 2: "external automatic"}
"""Parameter of PutAutoMode and result of GetAutoMode (RC7)."""

SPEED_AXES: Mapping[int, str] = {-1: "tool tip"}
"""Meaning of lAxis in Robot_Speed and Robot_Accelerate; all other numbers are axis numbers."""

SYS_STATE_BITS: Mapping[int, str] = {
    0: "program running",
    1: "robot error",
    2: "servo on",
    3: "initialisation done",
    4: "automatic mode",
    5: "automatic mode, token not at the pendant",
    6: "battery warning",
    7: "robot warning",
    8: "continue start allowed",
    10: "emergency stop",
    11: "automatic enable",
    12: "protective stop",
    13: "stopping",
    16: "program start reset",
    17: "calibration done",
    18: "manual mode",
    19: "one cycle done",
    20: "moving (set point)",
    21: "moving (encoder)",
    24: "command done",
}
"""Bits of the result of the command SysState; all other bits are reserved."""

OBJECT_OPTIONS: Mapping[str, str] = {
    "@IfNotMember": "use the object that exists when the name is taken",
    "@Create": "1 makes the file",
    "$IsIDHandle$": "the handle is the object's number (RC7)",
    "WDT": "ms between two S_EXECUTING",
    "InvokeTimeout": "ms that a call may run",
    "Interval": "polling of messages in ms (COBOTTA PRO)",
    "Server": "address of a camera",
}
"""Keys in bstrOption of Service_Start, Controller_Connect and the ..._Get... functions. WDT and InvokeTimeout
must be at least 80 ms."""

MOVE_OPTIONS: Mapping[str, str] = {
    "SPEED": "speed in percent",
    "ACCEL": "acceleration in percent",
    "DECEL": "deceleration in percent",
    "TIME": "duration of the motion",
    "NEXT": "the call returns before the motion ends",
}
"""Keys in bstrOption of Robot_Move."""

PROVIDERS: Mapping[str, str] = {
    "CaoProv.DENSO.NetwoRC": "RC7, which ignores the name",
    "CaoProv.DENSO.VRC": "RC8, RC8A, COBOTTA",
    "CaoProv.DENSO.VRC9": "RC9, COBOTTA PRO",
    "CaoProv.DENSO.RC8": "provider for a PC; refused over b-CAP with E_INVALIDARG",
    "CaoProv.DENSO.EVP2": "EVP2 vision",
    "CaoProv.DENSO.ESC11PCI": "electric hand ESC11",
    "CaoProv.Canon.N10-W02": "Canon camera",
}
"""bstrProvider of Controller_Connect."""


def sys_state_texts(value: int) -> tuple[str, ...]:
    """Return the meanings of the bits set in a result of SysState, lowest bit first.

    A reserved bit is named by its number, such as `bit 9`.
    """
    return tuple(SYS_STATE_BITS.get(bit, f"bit {bit}") for bit in range(32) if value >> bit & 1)


def result_meanings(function_id: int, command: str, value: int) -> tuple[str, ...]:
    """Return the meanings of a number that a command returned; () for a number without special meaning."""
    key = function_id, command.casefold()
    if key == (_CONTROLLER_EXECUTE, "sysstate"):
        return sys_state_texts(value)
    text = _RESULT_MEANINGS.get(key, {}).get(value)
    return () if text is None else (text,)


def pass_motion_text(value: int) -> str:
    """Return the notation of a pass motion, such as `@E`."""
    return PASS_MOTIONS.get(value, f"@{value}")


def option_meanings(text: str, is_move: bool) -> dict[str, str]:
    """Return the meanings of the known keys in an option string such as `SPEED=50,NEXT`, ignoring case."""
    known = MOVE_OPTIONS if is_move else OBJECT_OPTIONS
    keys = {part.partition("=")[0].strip().casefold() for part in text.split(",")}
    return {key: meaning for key, meaning in known.items() if key.casefold() in keys}


def provider_meaning(name: str) -> str | None:
    """Return the meaning of a provider name, ignoring case; None if unknown."""
    return _MEANING_BY_PROVIDER.get(name.casefold())


_CONTROLLER_EXECUTE, _TASK_EXECUTE = 17, 87
_RESULT_MEANINGS: Mapping[tuple[int, str], Mapping[int, str]] = {
    (_TASK_EXECUTE, "getstatus"): TASK_STATES,
    (_CONTROLLER_EXECUTE, "getautomode"): AUTO_MODES,
}
_MEANING_BY_PROVIDER = {name.casefold(): text for name, text in PROVIDERS.items()}
