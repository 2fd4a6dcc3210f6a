"""The behaviours of the simulated controller, with source and certainty.

Each behaviour is named after the field of `Profile` that decides it, or the constant of its result, or else
by a word of our own. A behaviour that is only partly known has one row per part.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Certainty(StrEnum):
    """Degree of certainty that a real controller does the same."""

    DOCUMENTED = "documented"
    """A document or list of the vendor, or a published description of its commands, says so."""
    OBSERVED = "observed"
    """Seen in the vendor's server or driver, in dumps, or reported by users."""
    ASSUMED = "assumed"
    """No source says so; it is the likeliest behaviour, or the simplest that works."""


class Behaviour(NamedTuple):
    """One behaviour: what the controller does, as one clause, and its source.

    If a behaviour is assumed, the source says what it was concluded from.
    """

    name: str
    certainty: Certainty
    text: str
    source: str


_SLIDES = "DENSO Wave 2009, How to use the Slave mode"
_ERRORS = "list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
_CODES = "denso_robot.py in nkawa/Denso_CobottaPro900_MQTT_Control"
_SAMPLES = "ShoheiKobata/orin_bcap_python_samples"
_MODES = f"{_SAMPLES}, table of slave modes"
_DRIVER = "DENSORobot/denso_robot_ros2 denso_robot_core"
_ISSUES = "issues of DENSORobot/denso_robot_ros"
_MAIN = "start-jsk/denso denso_controller/src/main.cpp"
_ANSI = "b-Cap.h of the ANSI-C client"
_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"
_SYMBOLS = "orin_bcap CSharp ORiNDefine.cs"
_COMMON = "orin_bcap C/include/dn_common.h"
_LIMITS = "orin_bcap C/include/dn_udp.h"
_PROVIDER = "H. Suzuki, VE026A_JNI.java (a wrapper of the RC8 provider)"
_SCRIPTS = "DENSO's texts quoted in nkawa/Denso_CobottaPro900_MQTT_Control"
_GRIPPER = "DENSORobot/denso_cobotta_ros denso_cobotta_gripper"
_NONE = "no source says"
_AS_SERVER = f"as in {_SERVER}"

_D, _O, _A = Certainty.DOCUMENTED, Certainty.OBSERVED, Certainty.ASSUMED

WITHOUT_EFFECT = (
    *("AutoCal", "ForceWaitCondition", "PayLoad", "SpeedMode", "HighPathAccuracy", "GrvOffset"),
    *("ManualReset", "ResetStoState", "ManualResetPreparation", "MotionPreparation"),
)
"""Commands that the simulator accepts with any parameter."""

_PROFILE = (
    ("generation", _D, "modes 0x001 to 0x103 of RC7: Sync and Async", _SLIDES),
    ("generation", _D, "modes of later controllers: 0 (0x00n), 1 (0x10n), 2 (0x20n)", _MODES),
    (
        "replies",
        _D,
        "on RC7 a reply repeats the reserved field of its request",
        f"{_SLIDES}, dumps of retries",
    ),
    ("replies", _A, "reserved is 0 on later controllers", _AS_SERVER),
    ("no_argument", _D, "on RC7 the reply to slvChangeMode carries no argument", _SLIDES),
    ("no_argument", _A, "on RC7 this also applies to a refused slvChangeMode", _NONE),
    (
        "no_argument",
        _A,
        "any other reply without a value carries EMPTY if the call can return one",
        _AS_SERVER,
    ),
    (
        "no_argument",
        _A,
        "with --no-argument always none does; with never the reply to slvChangeMode does too",
        "ours",
    ),
    ("mode_type", _D, "slvGetMode returns VT_I2 on RC7", _SLIDES),
    ("mode_type", _A, "slvGetMode returns VT_I4 on later controllers", _NONE),
    ("real", _D, "poses are VT_R4 on RC7", _SLIDES),
    ("real", _O, "poses are VT_R8 on later controllers", f"{_DRIVER}; {_SAMPLES}"),
    ("providers", _D, "Controller_Connect needs CaoProv.DENSO.VRC, on RC9 CaoProv.DENSO.VRC9", _SAMPLES),
    ("providers", _O, "RC7 accepts any provider, also none", "a comment in a public copy of DENSO's sample"),
    ("needs_robslave", _D, "slave mode of RC7 needs the running program RobSlave", _SLIDES),
    ("needs_arm", _D, "motions need TakeArm", _SAMPLES),
    ("needs_arm", _A, "motions do not need TakeArm on RC7", f"not in the procedure of {_SLIDES}"),
    ("async_detector", _D, "a late set point ends an Async mode of RC7 if the pendant says so", _SLIDES),
    ("running_result", _D, "600B: the robot has not come to rest within 500 ms of slvChangeMode", _SLIDES),
    ("running_result", _A, "600B in 32 bits is 0000600B", _NONE),
    ("running_result", _D, "8150100D on later controllers", _ERRORS),
    (
        "lacks",
        _A,
        "commands of other generations and of other controllers' hands are not known",
        "only controllers whose documents name a command have it",
    ),
    ("TOOLn WORKn _ITP", _O, "are variables of RC7 only", "public RC7 clients"),
    ("TOOLn WORKn", _A, "hold the definitions of SetToolDef and SetWorkDef, six numbers", "their meaning"),
    ("_ITP", _A, "is 0 and cannot be written", _NONE),
    ("version", _A, "@VERSION of each generation", _NONE),
    ("defects", _O, "the C server forgets the first serial and takes serial 0 for a retry", _SERVER),
)

_RESULTS = (
    ("E_INVALIDARG", _O, "there is no such function, or WDT is too short", _SERVER),
    ("E_INVALIDARG", _O, "the format of set points is unknown, or the provider is wrong", f"{_ISSUES}, 47"),
    ("E_INVALIDARG", _A, "the provider is that of a camera or another device", "as for other providers"),
    ("E_INVALIDARG", _A, "an argument is missing or invalid; the C server does not check this", _NONE),
    ("E_NOTIMPL", _O, "a function is not simulated, like one without a callback in the C server", _SERVER),
    ("E_NOTIMPL", _A, "Chuck, Unchuck, GoHome: not among the methods of the RC8 provider", _PROVIDER),
    ("E_NOTIMPL", _A, "Rotate, which RC8 has: no source explains how its plane is given", _NONE),
    ("E_NOTIMPL", _A, "functions that change or run files, delete programs or answer messages", "ours"),
    ("E_HANDLE", _A, "a handle is wrong, released, or of another class", f"the name in {_COMMON}"),
    ("E_MAX_OBJECT", _O, "a client has 1000 objects", _SERVER),
    ("E_BUSY", _O, "a call after one that ran longer than InvokeTimeout", _SERVER),
    ("E_TOO_MUCH_DATA", _A, "a reply over UDP would have more than 503 bytes", _LIMITS),
    ("E_FAIL", _A, "slave mode of RC7 without RobSlave", _NONE),
    (
        "E_CAO_COLLECTION_REGISTERED",
        _A,
        "a client connects to a controller twice under the same name",
        _SYMBOLS,
    ),
    ("E_NOT_CONNECTED", _A, "any call before Service_Start", _SYMBOLS),
    ("OBJECT_NOT_FOUND", _A, "there is no variable, program or file of that name", _SYMBOLS),
    ("NOT_WRITABLE", _A, "a variable cannot be written", _SYMBOLS),
    ("INVALID_COMMAND", _D, "there is no such command", _ANSI),
    ("OUT_OF_MEMORY", _A, "a name or a value is too long to be stored", "our bound"),
    (
        "TYPE_MISMATCH",
        _A,
        "a number, text or pose is needed, and the argument is none",
        f"the name in {_COMMON}",
    ),
    ("OVERFLOW", _A, "a number does not fit into a variable", f"the name in {_COMMON}"),
    ("BAD_INDEX", _A, "a variable, I/O or record of that number does not exist", f"the name in {_COMMON}"),
    ("MOTOR_IS_OFF", _D, "a motion while the motor is off", _ERRORS),
    ("ERROR_IS_ACTIVE", _D, "a motion while an error is active", _ERRORS),
    ("NOT_AUTOMATIC", _D, "a motion in manual mode", _ERRORS),
    ("NO_TOKEN", _D, "a motion while the executable token is not set to Ethernet", _ERRORS),
    ("EMERGENCY_STOP", _D, "a motion while the emergency stop is pressed", _ERRORS),
    ("EMERGENCY_STOP", _A, "ClearError while the stop is pressed, and the motion that the stop ended", _NONE),
    (
        "E_ARM_NOT_TAKEN",
        _O,
        "a motion without TakeArm, or TakeArm while another client holds the arm",
        f"{_ISSUES}, 29",
    ),
    ("E_ROBOTISBUSY", _O, "a motion while another one runs; clients then repeat the call", _ANSI),
    ("IS_STOPPING", _A, "the motion that a Robot_Halt stops", f"the text in {_ERRORS}"),
    ("SOFTWARE_LIMIT", _D, "the goal of a motion is beyond a limit", _ERRORS),
    ("POSITION_LIMIT", _D, "a set point is beyond a limit; the motor goes off", _ERRORS),
    ("SPEED_LIMIT", _D, "a set point needs an axis to be too fast; slave mode ends", _ERRORS),
    ("ACCELERATION_LIMIT", _D, "a set point needs an axis to accelerate too much; slave mode ends", _ERRORS),
    ("INVALID_SET_POINT", _D, "a set point is not a number; slave mode ends", _ERRORS),
    (
        "E_REFUSED_IN_SLAVE_MODE",
        _O,
        "a call that slave mode forbids; the call ends slave mode",
        f"{_ISSUES}, 42",
    ),
    (
        "E_REFUSED_IN_SLAVE_MODE",
        _A,
        "slvChangeMode to another mode, which ends slave mode too",
        f"{_ISSUES}, 42",
    ),
    ("E_NOT_IN_SLAVE_MODE", _O, "slvMove while slave mode is off", f"{_ISSUES}, 6 and 42"),
    ("E_SLAVE_UNDERFLOW", _O, "no set point in time while moving; slave mode ends", f"{_ISSUES}, 49"),
    ("E_SLAVE_OVERFLOW", _D, "one set point more than the buffer of mode 0 holds", f"{_ERRORS}; {_SAMPLES}"),
    ("HAND_IS_MOVING", _D, "a hand command while the hand is moving", _ERRORS),
    ("HAND_SETTING", _D, "width, speed or force of a hand is out of range", _ERRORS),
    ("GRIP_BEYOND_LIMIT", _D, "HandMoveAH ends beyond the hand's stroke", _ERRORS),
    ("RELATIVE_GRIP_BEYOND_LIMIT", _D, "HandMoveRH ends beyond the hand's stroke", _ERRORS),
    ("HAND_STOPPED", _D, "the hand command that HandStop or another stop ends", _ERRORS),
    (
        "HAND_DEVIATION",
        _O,
        "fingers hit an object in a command that does not grip; the motor goes off",
        f"{_ISSUES}, 46",
    ),
    ("NOTHING_GRIPPED", _D, "TwofgGrip finds nothing to grip", _SCRIPTS),
    ("BRACKET_IS_OPEN", _D, "SyncTimeStart or SyncMoveStart is called a second time", _ERRORS),
    ("BRACKET_IS_CLOSED", _D, "SyncTimeEnd or SyncMoveEnd is called without its start", _ERRORS),
    ("S_BUF_FULL", _O, "the buffer of mode 0 is now full; the set point was accepted", f"{_DRIVER}; {_MAIN}"),
)

_OTHERS = (
    ("retries", _D, "a retry has a new serial, and the first serial in reserved", _SLIDES),
    ("retries", _O, "a retry is answered again and not executed again", _SERVER),
    ("notices", _O, "S_EXECUTING is sent every WDT ms while a call runs", _SERVER),
    ("notices", _O, "WDT and InvokeTimeout are at least 80 ms", _SERVER),
    ("bad datagram", _A, "is dropped; in the C server, it ends the UDP service", "for the simulator's users"),
    (
        "floods",
        _A,
        "senders of datagrams take turns; at most 32 datagrams of a sender wait",
        "for the simulator's users",
    ),
    ("time", _A, "stops while the simulator gets no processor time", "for the simulator's users"),
    (
        "time",
        _A,
        "in Async modes and mode 1, a set point counts from its arrival instead",
        "clients do not wait",
    ),
    (
        "time",
        _A,
        "set points that arrive together on TCP count as evenly spaced",
        "their own times are unknown",
    ),
    ("bad frame", _O, "ends its TCP connection without a reply", _SERVER),
    ("clients", _O, "20 over each transport; on UDP one may be forgotten after 10 s of silence", _SERVER),
    ("clients", _A, "a connection takes a place with its first frame", "for the simulator's users"),
    ("clients", _A, "a stop gets a place even if all are taken", "for the simulator's users"),
    ("reset", _D, "the button on the pendant frees the places of dead clients", _SLIDES),
    ("period", _D, "the controller takes one set point every 8 ms", _SLIDES),
    ("period", _A, "the controller's own clock sets the cycle, not the client's", _NONE),
    ("buffers", _D, "1 set point waits in mode 1, 3 in modes 0 and 2", _MODES),
    ("buffers", _A, "1 set point waits on RC7; a slvMove of a Sync mode returns when it was taken", _NONE),
    ("standstill", _D, "slvChangeMode waits up to 500 ms for standstill", _SLIDES),
    ("error", _D, "an error ends slave mode and RobSlave, and stays active until ClearError", _SLIDES),
    ("current errors", _O, "RC8 lists 83500121 and 83501032 until ClearError", f"{_ISSUES}, 42"),
    (
        "current errors",
        _A,
        "RC7 lists them too, because a refused slvMove stops RobSlave",
        f"as other errors in {_SLIDES}",
    ),
    ("current errors", _A, "each of the two is listed once, however often the call is repeated", _NONE),
    (
        "owed error",
        _O,
        "the next slvMove returns the error, later ones return that slave mode is off",
        f"{_ISSUES}, 20",
    ),
    ("allowed in slave mode", _O, "slvMove, slvGetMode, CurPos, CurJnt, GetSrvData and the like", _CODES),
    ("allowed in slave mode", _A, "other calls that only read", _NONE),
    ("motor", _D, "errors of level 4 and 5 switch it off", _ERRORS),
    ("motor", _A, "takes 400 ms to go on", _NONE),
    ("@SERVO_ON", _O, "writing it switches the motor on or off", _DRIVER),
    ("@SERVO_ON", _A, "the call lasts as long as Motor and is refused with the same results", _NONE),
    (
        "external speeds",
        _A,
        "writing @EXTSPEED, @EXTACCEL, @EXTDECEL is refused in slave mode as ExtSpeed is",
        _NONE,
    ),
    ("task variables", _A, "writing @START and @STOP is refused as Task_Start and Task_Stop are", _NONE),
    (
        "arm's owner",
        _D,
        "TakeArm resets internal speed, tool and work unless its option keeps them",
        _SAMPLES,
    ),
    ("arm's owner", _A, "the arm is free when its client is gone", _NONE),
    ("hold", _D, "Robot_Hold pauses a motion, Robot_Unhold continues it", _PROVIDER),
    ("hold", _A, "also on RC7, at once, by any client; the motion continues from standstill", _NONE),
    (
        "encoders",
        _A,
        "show the position that was commanded 24 ms before",
        f"joints behind their set points in {_SLIDES}",
    ),
    ("formats", _O, "slvSendFormat and slvRecvFormat choose the parts of slvMove", _DRIVER),
    ("formats", _A, "0x400 of the send format 0x620 is accepted and changes nothing", _NONE),
    ("formats", _A, "without slvRecvFormat, slvMove returns a pose of the mode's type", _SLIDES),
    ("motions", _A, "follow the minimum-jerk curve, as fast as the limits of the axes allow", _NONE),
    (
        "motions",
        _A,
        "a line is moved like PTP; with @P the next motion begins after 70 % of the time",
        "ours",
    ),
    ("motions", _A, "a circle is moved like PTP to its second pose; a free curve does not move", "ours"),
    ("robot", _A, "a simple arm of six axes, with limits and lengths of its own", _NONE),
    ("order of checks", _A, "emergency stop, errors, mode, token, motor, arm", _NONE),
    ("control log", _D, "each record has 39 values", f"{_SAMPLES}, Get_Syslog"),
    (
        "control log",
        _A,
        "one record every 8 ms, at most 10,000; currents and loads follow the encoders' lag",
        "ours",
    ),
)

_COMMANDS = (
    ("HandMove...", _D, "0 to 30 mm, 1 to 100 % of 80 mm/s, 800 mm/s², 6 to 20 N", _GRIPPER),
    ("HandMove...", _D, "the motor must be on", _GRIPPER),
    ("HandMove...", _O, "TakeArm is not needed; another client may move the hand in slave mode", _SAMPLES),
    (
        "HandMove...",
        _A,
        "the client in slave mode may not move the hand",
        f"no hand while the arm moves: {_ISSUES}, 13",
    ),
    ("HandMove...", _A, "the call lasts as long as the motion, unless the option is NEXT", _SAMPLES),
    ("HandMove...", _A, "Robot_Halt and every other stop of the arm also stop the hand", _NONE),
    ("HandMoveH", _A, "moves at 20 mm/s; the option DetectOn changes nothing", _NONE),
    ("HandMoveAH HandMoveRH", _A, "grip an object on their way; reaching the width is no error", _SAMPLES),
    ("HandMoveVH", _A, "40 to 100 %; the pressure follows the power, and the load is 50 %", _GRIPPER),
    ("HandChuck HandUnChuck", _A, "move at 50 % of the speed with 10 N, for every point number", _NONE),
    ("HandStop", _O, "stops the vacuum", _SAMPLES),
    ("HandStop", _A, "is accepted from every client, also in slave mode; a grip stays", _NONE),
    ("HandHoldState", _A, "true while the fingers press on an object, which a scenario puts there", _SAMPLES),
    ("HandHoldState", _D, "without the motor's power the hand loses its grip", f"80500371 in the {_ERRORS}"),
    ("Hand0", _A, "the extension is COBOTTA's hand, and its CurPos is the width", _NONE),
    ("HandGrip HandRelease", _A, "move the 2FG hand and do not wait", _SCRIPTS),
    ("TwofgGrip", _D, "20 to 140 N, 10 to 100 %, 1 to 39 mm", _SCRIPTS),
    ("TwofgGrip", _A, "100 mm/s at 100 %; the hand grips from outside", _NONE),
    ("Dev DevH", _D, "shift a pose in work or tool coordinates; Fig is that of the first pose", _SCRIPTS),
    ("Dev DevH", _A, "turn about fixed axes in Dev, about the pose's own axes in DevH", _NONE),
    ("CheckVirtualFence", _A, "returns 0: the simulated robot has no fences", "ours"),
    ("SetToolDef SetWorkDef", _A, "are stored and returned; CurPos does not change", "ours"),
    ("ConvertPosWork", _A, "converts a pose from the first work to the second", _NONE),
    ("SyncTimeStart SyncTimeEnd", _A, "motions between them run at once", "there is one robot"),
    ("SyncMoveStart SyncMoveEnd", _A, "motions between them run at once", "there is one robot"),
    ("MotionSkip", _A, "stops the arm; the motion's call returns S_OK", _SAMPLES),
    ("ForceCtrl", _D, "needs TakeArm; stays off without the motor; numbers 1 to 10", _SCRIPTS),
    ("ForceCtrl ForceParam", _A, "change no motion", "ours"),
    ("GetMotionPreparationState", _A, "returns true", "ours"),
    ("ForceValue CurForceSensorPayLoad", _A, "return zeros", "ours"),
    ("GetMechaButtonState ClearMechaButtonState CurScene CurSubScene SceneInfo", _A, "return zeros", "ours"),
    ("SetAreaEnabled GetAreaEnabled", _A, "areas 0 to 31 are stored; none limits the robot", "ours"),
    ("Comm", _A, "every line can be opened, and receives nothing", "ours"),
    ("CalcPos", _A, "counts from the first corner to the second, row by row to the third", _NONE),
    *((name, _A, "returns S_OK and has no effect", _NONE) for name in WITHOUT_EFFECT),
    ("results", _A, "types that the catalogue of commands infers", "their meaning"),
    ('pose [1, "P", "@0"]', _O, "the number of a variable, its type and the pass", "public clients"),
    ("option SPEED=F2", _O, "a variable gives the number", "public clients"),
    ("option ACCEL DECEL", _A, "are checked and change nothing", "ours"),
    ("ManualResetPreparation", _A, "is accepted on the controller, too", "a public client calls it there"),
)

BEHAVIOURS: tuple[Behaviour, ...] = tuple(
    Behaviour(*row) for row in (*_PROFILE, *_RESULTS, *_OTHERS, *_COMMANDS)
)
"""Every behaviour; those of the profiles come first."""
