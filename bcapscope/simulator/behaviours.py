"""What the simulated controller does, where we have it from, and how sure we are.

A behaviour goes by the field of `Profile` that decides it, by the constant of the result that it ends in, or,
where it is neither, by a word of ours.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Certainty(StrEnum):
    """How sure we are that a real controller does the same."""

    DOCUMENTED = "documented"
    """A paper, sample or list of the vendor says so."""
    OBSERVED = "observed"
    """Seen: in the vendor's server, in dumps, or by users who reported it."""
    ASSUMED = "assumed"
    """Nobody says so; it is what seems likeliest, or the least that works."""


class Behaviour(NamedTuple):
    """One behaviour.

    Attributes:
        name: field, constant or word.
        text: what is done, one clause.
        certainty: how sure we are.
        source: where we have it from; where it is assumed, what it was concluded from.
    """

    name: str
    text: str
    certainty: Certainty
    source: str


_SLIDES = "DENSO Wave 2009, How to use the Slave mode"
_ERRORS = "list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
_SAMPLES = "ShoheiKobata/orin_bcap_python_samples"
_DRIVER = "DENSORobot/denso_robot_ros2 denso_robot_core"
_ISSUES = "issues of DENSORobot/denso_robot_ros"
_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"
_SYMBOLS = "orin_bcap CSharp ORiNDefine.cs"
_NONE = "no source says"

_D, _O, _A = Certainty.DOCUMENTED, Certainty.OBSERVED, Certainty.ASSUMED

_PROFILE = (
    ("generation", "the number of a slave mode means another thing on RC7 and on later ones", _D, _SLIDES),
    ("replies", "reserved is repeated on RC7, as in dumps, and 0 on later ones", _A, f"{_SLIDES}; {_SERVER}"),
    ("empty_result", "slvChangeMode answers no argument on RC7, EMPTY on later ones", _O, _DRIVER),
    ("empty_on_error", "a refused call that could have a result carries EMPTY, but on RC7", _A, _SERVER),
    ("mode_type", "slvGetMode answers VT_I2 on RC7", _D, _SLIDES),
    ("real", "poses are VT_R4 on RC7 and VT_R8 on later ones", _O, f"{_SLIDES}; {_SAMPLES}"),
    ("providers", "Controller_Connect wants VRC, VRC9 on RC9; RC7 takes any", _D, f"{_SAMPLES}; {_SLIDES}"),
    ("needs_robslave", "slave mode of RC7 needs the running program RobSlave", _D, _SLIDES),
    ("needs_arm", "motions need TakeArm, but on RC7", _D, _SAMPLES),
    ("async_detector", "a late set point ends an Async mode of RC7 if the pendant says so", _D, _SLIDES),
    (
        "running_result",
        "slvChangeMode is refused when the robot moves for 500 ms more",
        _D,
        f"{_SLIDES}; {_ERRORS}",
    ),
    ("lacks", "commands of other generations are not known", _A, "who documents a command has it"),
    ("version", "@VERSION of each generation", _A, _NONE),
    ("defects", "the C server forgets the first serial and takes serial 0 for a retry", _O, _SERVER),
)

_RESULTS = (
    ("E_INVALIDARG", "an argument is missing or makes no sense, or there is no such function", _O, _SERVER),
    ("E_NOTIMPL", "a function or a known command is not simulated", _O, _SERVER),
    ("E_HANDLE", "a handle is wrong, released, or of another class", _O, _SERVER),
    ("E_MAX_OBJECT", "a client has 1000 objects", _D, _SERVER),
    ("E_BUSY", "a call after one that ran longer than InvokeTimeout", _O, _SERVER),
    (
        "E_TOO_MUCH_DATA",
        "an answer over UDP would have more than 503 bytes",
        _A,
        "orin_bcap C/include/dn_udp.h",
    ),
    ("E_FAIL", "slave mode of RC7 without RobSlave", _A, _NONE),
    ("E_CAO_COLLECTION_REGISTERED", "a controller is connected twice by one name", _A, _SYMBOLS),
    ("NOT_CONNECTED", "any call before Service_Start", _A, _SYMBOLS),
    ("OBJECT_NOT_FOUND", "there is no variable, program or file of that name", _A, _SYMBOLS),
    ("NOT_WRITABLE", "a variable cannot be written", _A, _SYMBOLS),
    ("INVALID_COMMAND", "there is no such command", _A, _SYMBOLS),
    ("OUT_OF_MEMORY", "a name or a value is too long to be kept", _A, "our bound"),
    ("TYPE_MISMATCH", "a number, text or pose is wanted and none is there", _A, _SYMBOLS),
    ("OVERFLOW", "a number does not fit into a variable", _A, _SYMBOLS),
    ("BAD_INDEX", "a variable, I/O or record of that number does not exist", _A, _SYMBOLS),
    ("MOTOR_IS_OFF", "a motion while the motor is off", _D, _ERRORS),
    ("ERROR_IS_ACTIVE", "a motion while an error is active", _D, _ERRORS),
    ("NOT_AUTOMATIC", "a motion in manual mode", _D, _ERRORS),
    ("NO_TOKEN", "a motion while the executable token is another's", _D, _ERRORS),
    (
        "EMERGENCY_STOP",
        "a motion while the emergency stop is pressed, which also ends all motions",
        _D,
        _ERRORS,
    ),
    ("E_ARM_NOT_TAKEN", "a motion without TakeArm, or TakeArm while another has the arm", _D, _ERRORS),
    ("E_ROBOTISBUSY", "a motion while another one goes on", _A, _SYMBOLS),
    ("IS_STOPPING", "the motion that a Robot_Halt stops", _D, _ERRORS),
    ("SOFTWARE_LIMIT", "the goal of a motion is beyond a limit", _D, _ERRORS),
    ("POSITION_LIMIT", "a set point is beyond a limit; the motor goes off", _D, _ERRORS),
    ("SPEED_LIMIT", "a set point needs an axis to be too fast; slave mode ends", _D, _ERRORS),
    ("ACCELERATION_LIMIT", "a set point needs an axis to accelerate too much; slave mode ends", _D, _ERRORS),
    ("INVALID_SET_POINT", "a set point is no number; slave mode ends", _D, _ERRORS),
    ("E_REFUSED_IN_SLAVE_MODE", "a call that slave mode forbids, which ends it", _O, f"{_ISSUES}, 42 and 48"),
    ("E_NOT_IN_SLAVE_MODE", "slvMove while slave mode is off", _O, f"{_ISSUES}, 6 and 42"),
    ("E_SLAVE_UNDERFLOW", "no set point in time while moving; slave mode ends", _O, f"{_ISSUES}, 49"),
    ("E_SLAVE_OVERFLOW", "a set point more than the buffer of mode 0 holds", _D, f"{_SAMPLES}, slave modes"),
    ("S_BUF_FULL", "the buffer of mode 0 is full; the set point counts", _D, f"{_SAMPLES}, slave modes"),
)

_OTHERS = (
    ("retries", "a request that comes again is answered again and not executed again", _D, _SLIDES),
    (
        "notices",
        "S_EXECUTING each WDT while a call runs; WDT and InvokeTimeout of 80 ms at least",
        _O,
        _SERVER,
    ),
    ("bad datagram", "is dropped; the C server's UDP service ends", _A, "for the simulator's users"),
    ("bad frame", "ends its TCP connection without a reply", _O, _SERVER),
    ("clients", "20 over each transport; on UDP one may be forgotten after 10 s of silence", _O, _SERVER),
    ("reset", "the button on the pendant frees the places of dead clients", _D, _SLIDES),
    ("period", "one set point is taken each 8 ms", _D, _SLIDES),
    ("buffers", "1 set point waits on RC7 and in mode 1, 3 in modes 0 and 2", _D, f"{_SLIDES}; {_SAMPLES}"),
    ("standstill", "slvChangeMode waits 500 ms for it", _D, _SLIDES),
    ("error", "an error ends slave mode and RobSlave, and stays active until ClearError", _D, _SLIDES),
    ("encoders", "show what was commanded 24 ms before", _A, f"joints behind their set points in {_SLIDES}"),
    ("formats", "slvSendFormat and slvRecvFormat choose the parts of slvMove", _D, _DRIVER),
    ("motions", "follow the minimum-jerk curve, as fast as the limits of the axes allow", _A, _NONE),
    ("arm", "a simple one of six axes; limits and lengths are ours", _A, _NONE),
    ("motor", "takes 400 ms to go on", _A, _NONE),
    ("order of checks", "emergency stop, errors, mode, token, motor, arm", _A, _NONE),
    (
        "control log",
        "a record of 39 values each 8 ms; what no source explains is ours",
        _D,
        f"{_SAMPLES}, Get_Syslog",
    ),
)

BEHAVIOURS: tuple[Behaviour, ...] = tuple(Behaviour(*row) for row in (*_PROFILE, *_RESULTS, *_OTHERS))
"""Every behaviour, those of the profiles first."""
