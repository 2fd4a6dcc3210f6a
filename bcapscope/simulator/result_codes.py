"""Result codes with which the simulated controller refuses calls, named for their meaning.

Sources for the meanings: the public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control;
symbols of CAO: orin_bcap CSharp ORiNDefine.cs. For a code that depends on the axis, the constant is the code
for axis 0; add the axis number 1..8.
"""

from __future__ import annotations

OBJECT_NOT_FOUND = 0x80000204
NOT_WRITABLE = 0x8000020A
INVALID_COMMAND = 0x80010005
OUT_OF_MEMORY = 0x8007000E
TYPE_MISMATCH = 0x80020005
OVERFLOW = 0x8002000A
BAD_INDEX = 0x8002000B

MOTOR_IS_OFF = 0x81501003
ERROR_IS_ACTIVE = 0x81501025
NOT_AUTOMATIC = 0x81501017
EMERGENCY_STOP = 0x8150101A
NO_TOKEN = 0x83501028

SPEED_LIMIT = 0x84204050
ACCELERATION_LIMIT = 0x84204040
POSITION_LIMIT = 0x83204230
SOFTWARE_LIMIT = 0x83204070


HAND_IS_MOVING = 0x83500301
HAND_SETTING = 0x83500314
HAND_STOPPED = 0x835002FF
HAND_DEVIATION = 0x8450031C
GRIP_BEYOND_LIMIT = 0x83500362
RELATIVE_GRIP_BEYOND_LIMIT = 0x83500363
NOTHING_GRIPPED = 0x8350048F
BRACKET_IS_OPEN = {"time": 0x83500189, "move": 0x83500190}
BRACKET_IS_CLOSED = {"time": 0x83500191, "move": 0x83500192}


def error_level(code: int) -> int:
    """Return the error level of a controller code, its second hex digit; 0 for other codes."""
    return code >> 24 & 0xF if code >> 28 == 8 else 0
