"""The behaviours of the simulated controller, with source and certainty.

The name of a behaviour is the field of `Profile` that decides it, the constant of its result, or else a word
of the simulator. A behaviour that is only partly known has one row per part.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Certainty(StrEnum):
    """Degree of certainty that a real controller behaves like the simulator."""

    DOCUMENTED = "documented"
    """The vendor's documents or lists, or published descriptions of its commands, state the behaviour."""
    OBSERVED = "observed"
    """The behaviour was seen in the vendor's server or driver or in dumps, or was reported by users."""
    ASSUMED = "assumed"
    """No source states the behaviour; it is the likeliest one, or the simplest one that works."""


class Behaviour(NamedTuple):
    """A simulated behaviour: one clause that says what the controller does, and the source of this fact.

    For an assumed behaviour, `source` says what the assumption rests on.
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
_USERS = "for the simulator's users"
_AS_SERVER = f"as in {_SERVER}"

_D, _O, _A = Certainty.DOCUMENTED, Certainty.OBSERVED, Certainty.ASSUMED

WITHOUT_EFFECT = (
    *("AutoCal", "ForceWaitCondition", "PayLoad", "SpeedMode", "HighPathAccuracy", "GrvOffset"),
    *("ManualReset", "ResetStoState", "ManualResetPreparation", "MotionPreparation"),
)
"""Names of commands that the simulator accepts with any parameter, and that have no effect."""

_PROFILE = (
    ("generation", _D, "RC7 has the slave modes 0x001 to 0x103: Sync and Async", _SLIDES),
    ("generation", _D, "later controllers have the slave modes 0 (0x00n), 1 (0x10n) and 2 (0x20n)", _MODES),
    (
        "replies",
        _D,
        "RC7 repeats the reserved field of a request in the reply",
        f"{_SLIDES}, dumps of retries",
    ),
    ("replies", _A, "on later controllers the reserved field of a reply is 0", _AS_SERVER),
    ("no_argument", _D, "on RC7 the reply to slvChangeMode carries no argument", _SLIDES),
    ("no_argument", _A, "on RC7 the reply to a refused slvChangeMode also carries no argument", _NONE),
    (
        "no_argument",
        _A,
        "other replies without a value carry EMPTY if the call can return a value",
        _AS_SERVER,
    ),
    (
        "no_argument",
        _A,
        "--no-argument always: no reply without a value carries EMPTY; never: all such replies do",
        "ours",
    ),
    ("mode_type", _D, "slvGetMode returns VT_I2 on RC7", _SLIDES),
    ("mode_type", _A, "slvGetMode returns VT_I4 on later controllers", _NONE),
    ("real", _D, "poses are VT_R4 on RC7", _SLIDES),
    ("real", _O, "poses are VT_R8 on later controllers", f"{_DRIVER}; {_SAMPLES}"),
    ("providers", _D, "Controller_Connect needs CaoProv.DENSO.VRC, and on RC9 CaoProv.DENSO.VRC9", _SAMPLES),
    (
        "providers",
        _O,
        "Controller_Connect on RC7 accepts any provider, or none",
        "a comment in a public copy of DENSO's sample",
    ),
    ("needs_robslave", _D, "slave mode of RC7 needs the running program RobSlave", _SLIDES),
    ("needs_arm", _D, "motions need TakeArm on RC8 and RC9", _SAMPLES),
    ("needs_arm", _A, "motions on RC7 do not need TakeArm", f"not in the procedure of {_SLIDES}"),
    ("async_detector", _D, "a late set point can end an Async mode of RC7, as set on the pendant", _SLIDES),
    (
        "running_result",
        _D,
        "slvChangeMode returns 600B on RC7 if the robot still moves after 500 ms",
        _SLIDES,
    ),
    ("running_result", _A, "the 32-bit form of the result 600B is 0000600B", _NONE),
    ("running_result", _D, "later controllers return 8150100D instead of 600B", _ERRORS),
    (
        "lacks",
        _A,
        "a controller does not know commands of other generations and of other controllers' hands",
        "only controllers whose documents name a command have it",
    ),
    ("TOOLn WORKn _ITP", _O, "the variables TOOLn, WORKn and _ITP exist only on RC7", "public RC7 clients"),
    (
        "TOOLn WORKn",
        _A,
        "TOOLn and WORKn hold six numbers, set by SetToolDef and SetWorkDef",
        "their meaning",
    ),
    ("_ITP", _A, "the variable _ITP is 0 and cannot be written", _NONE),
    ("version", _A, "@VERSION has a value of its own for each generation", _NONE),
    ("defects", _O, "the C server forgets the first serial, and treats serial 0 as that of a retry", _SERVER),
)

_RESULTS = (
    ("E_INVALIDARG", _O, "result if a function does not exist, or WDT is too short", _SERVER),
    ("E_INVALIDARG", _O, "result if the format of set points or the provider is unknown", f"{_ISSUES}, 47"),
    ("E_INVALIDARG", _A, "result for the provider of a camera or another device", "as for other providers"),
    (
        "E_INVALIDARG",
        _A,
        "result if an argument is missing or wrong; the C server checks no arguments",
        _NONE,
    ),
    ("E_NOTIMPL", _O, "result of functions not simulated, or without callback in the C server", _SERVER),
    ("E_NOTIMPL", _A, "result of Chuck, Unchuck and GoHome, which the RC8 provider does not have", _PROVIDER),
    ("E_NOTIMPL", _A, "result of Rotate, which RC8 has, because no source describes its planes", _NONE),
    (
        "E_NOTIMPL",
        _A,
        "result of functions that change or run files, delete programs or answer messages",
        "ours",
    ),
    (
        "E_HANDLE",
        _A,
        "result if a handle is unknown, released, or of a wrong class",
        f"the name in {_COMMON}",
    ),
    ("E_MAX_OBJECT", _O, "result if a client already has 1000 objects", _SERVER),
    ("E_BUSY", _O, "result of the call after a call that ran longer than InvokeTimeout", _SERVER),
    ("E_TOO_MUCH_DATA", _A, "result if a reply over UDP would have more than 503 bytes", _LIMITS),
    ("E_FAIL", _A, "result of slvChangeMode on RC7 if RobSlave does not run", _NONE),
    (
        "E_CAO_COLLECTION_REGISTERED",
        _A,
        "result if a client connects to a controller twice under the same name",
        _SYMBOLS,
    ),
    ("E_NOT_CONNECTED", _A, "result of any call before Service_Start", _SYMBOLS),
    ("OBJECT_NOT_FOUND", _A, "result if no variable, program or file has the given name", _SYMBOLS),
    ("NOT_WRITABLE", _A, "result of writing a variable that cannot be written", _SYMBOLS),
    ("INVALID_COMMAND", _D, "result of a command that does not exist", _ANSI),
    ("OUT_OF_MEMORY", _A, "result if a name or a value is too long to be stored", "our bound"),
    (
        "TYPE_MISMATCH",
        _A,
        "result if an argument is not of the needed type: number, text or pose",
        f"the name in {_COMMON}",
    ),
    ("OVERFLOW", _A, "result if a number does not fit into a variable", f"the name in {_COMMON}"),
    ("BAD_INDEX", _A, "result if no variable, I/O or record has the given number", f"the name in {_COMMON}"),
    ("MOTOR_IS_OFF", _D, "result of a motion while the motor is off", _ERRORS),
    ("ERROR_IS_ACTIVE", _D, "result of a motion while an error is active", _ERRORS),
    ("NOT_AUTOMATIC", _D, "result of a motion in manual mode", _ERRORS),
    ("NO_TOKEN", _D, "result of a motion while the executable token is not set to Ethernet", _ERRORS),
    ("EMERGENCY_STOP", _D, "result of a motion while the emergency stop is pressed", _ERRORS),
    ("EMERGENCY_STOP", _A, "result of ClearError during an emergency stop, and of the stopped motion", _NONE),
    (
        "E_ARM_NOT_TAKEN",
        _O,
        "result of a motion without TakeArm, or of TakeArm while another client has the arm",
        f"{_ISSUES}, 29",
    ),
    ("E_ROBOTISBUSY", _O, "result of a motion during another motion; clients then repeat the call", _ANSI),
    ("IS_STOPPING", _A, "result of a motion that Robot_Halt stops", f"the text in {_ERRORS}"),
    ("SOFTWARE_LIMIT", _D, "result of a motion whose goal is beyond a limit", _ERRORS),
    ("POSITION_LIMIT", _D, "result of a set point beyond a limit; the motor goes off", _ERRORS),
    ("SPEED_LIMIT", _D, "result if a set point makes an axis too fast; slave mode ends", _ERRORS),
    (
        "ACCELERATION_LIMIT",
        _D,
        "result if a set point accelerates an axis too much; slave mode ends",
        _ERRORS,
    ),
    (
        "INVALID_SET_POINT",
        _D,
        "result if a set point holds a value other than a number; slave mode ends",
        _ERRORS,
    ),
    (
        "E_REFUSED_IN_SLAVE_MODE",
        _O,
        "result of a call that slave mode forbids; the call ends slave mode",
        f"{_ISSUES}, 42",
    ),
    (
        "E_REFUSED_IN_SLAVE_MODE",
        _A,
        "result of slvChangeMode to another slave mode; the call ends slave mode",
        f"{_ISSUES}, 42",
    ),
    ("E_NOT_IN_SLAVE_MODE", _O, "result of slvMove while slave mode is off", f"{_ISSUES}, 6 and 42"),
    (
        "E_SLAVE_UNDERFLOW",
        _O,
        "result if no set point arrives in time during a motion; slave mode ends",
        f"{_ISSUES}, 49",
    ),
    (
        "E_SLAVE_OVERFLOW",
        _D,
        "result of a set point that finds the buffer of mode 0 full",
        f"{_ERRORS}; {_SAMPLES}",
    ),
    ("HAND_IS_MOVING", _D, "result of a hand command while the hand is moving", _ERRORS),
    ("HAND_SETTING", _D, "result if width, speed or force of a hand is out of range", _ERRORS),
    ("GRIP_BEYOND_LIMIT", _D, "result if HandMoveAH would end beyond the hand's stroke", _ERRORS),
    ("RELATIVE_GRIP_BEYOND_LIMIT", _D, "result if HandMoveRH would end beyond the hand's stroke", _ERRORS),
    ("HAND_STOPPED", _D, "result of a hand command that HandStop or another stop ends", _ERRORS),
    (
        "HAND_DEVIATION",
        _O,
        "result if the fingers hit an object in a command without grip; the motor goes off",
        f"{_ISSUES}, 46",
    ),
    ("NOTHING_GRIPPED", _D, "result if TwofgGrip finds nothing to grip", _SCRIPTS),
    (
        "BRACKET_IS_OPEN",
        _D,
        "result of a second SyncTimeStart or SyncMoveStart before the end command",
        _ERRORS,
    ),
    ("BRACKET_IS_CLOSED", _D, "result of SyncTimeEnd or SyncMoveEnd without the start command", _ERRORS),
    (
        "S_BUF_FULL",
        _O,
        "result of slvMove if the buffer of mode 0 is now full; the set point was accepted",
        f"{_DRIVER}; {_MAIN}",
    ),
)

_OTHERS = (
    ("retries", _D, "a retry has a new serial; its reserved field holds the first attempt's serial", _SLIDES),
    ("retries", _O, "the controller answers a retry again, and does not execute it again", _SERVER),
    ("notices", _O, "the controller sends S_EXECUTING every WDT ms while a call runs", _SERVER),
    ("notices", _O, "WDT and InvokeTimeout must be at least 80 ms", _SERVER),
    ("bad datagram", _A, "a bad datagram is dropped; in the C server it ends the UDP service", _USERS),
    ("floods", _A, "senders of datagrams take turns, and at most 32 datagrams of a sender wait", _USERS),
    ("time", _A, "the controller's time stops while the simulator gets no processor", _USERS),
    (
        "time",
        _A,
        "in Async modes and mode 1, time does not stop: a set point counts from its arrival",
        "clients do not wait",
    ),
    (
        "time",
        _A,
        "set points that arrive together over TCP count as evenly spaced in time",
        "their own times are unknown",
    ),
    ("bad frame", _O, "a bad frame ends its TCP connection without a reply", _SERVER),
    ("clients", _O, "20 clients per transport; a UDP client may be forgotten after 10 s of silence", _SERVER),
    ("clients", _A, "a TCP connection takes a client's place with its first frame", _USERS),
    ("clients", _A, "a client that sends a stop gets a place even if all places are taken", _USERS),
    ("reset", _D, "the Reset button on the pendant frees the places of dead clients", _SLIDES),
    ("period", _D, "the controller takes one set point every 8 ms", _SLIDES),
    ("period", _A, "the controller's own clock sets the cycle, not the client's", _NONE),
    ("buffers", _D, "the buffer holds 1 set point in mode 1, and 3 in modes 0 and 2", _MODES),
    ("buffers", _A, "the buffer of RC7 holds 1 set point; in Sync modes slvMove waits for its turn", _NONE),
    ("standstill", _D, "slvChangeMode waits up to 500 ms until the robot stands still", _SLIDES),
    ("error", _D, "an error ends slave mode and RobSlave, and stays active until ClearError", _SLIDES),
    ("current errors", _O, "RC8 lists the errors 83500121 and 83501032 until ClearError", f"{_ISSUES}, 42"),
    (
        "current errors",
        _A,
        "RC7 also lists 83500121 and 83501032, because a refused slvMove stops RobSlave",
        f"as other errors in {_SLIDES}",
    ),
    (
        "current errors",
        _A,
        "83500121 and 83501032 are listed once each, however often a call is repeated",
        _NONE,
    ),
    (
        "owed error",
        _O,
        "the next slvMove returns the error; later calls return that slave mode is off",
        f"{_ISSUES}, 20",
    ),
    (
        "allowed in slave mode",
        _O,
        "slave mode accepts slvMove, slvGetMode, CurPos, CurJnt, GetSrvData and similar calls",
        _CODES,
    ),
    ("allowed in slave mode", _A, "slave mode accepts other calls that only read", _NONE),
    ("motor", _D, "errors of level 4 and 5 switch the motor off", _ERRORS),
    ("motor", _A, "the motor takes 400 ms to switch on", _NONE),
    ("@SERVO_ON", _O, "writing @SERVO_ON switches the motor on or off", _DRIVER),
    ("@SERVO_ON", _A, "writing @SERVO_ON takes as long as Motor, and is refused in the same cases", _NONE),
    ("external speeds", _A, "@EXTSPEED, @EXTACCEL, @EXTDECEL cannot be written in slave mode", _NONE),
    ("task variables", _A, "writing @START and @STOP is refused like Task_Start and Task_Stop", _NONE),
    ("arm's owner", _D, "TakeArm resets internal speed, tool and work unless an option keeps them", _SAMPLES),
    ("arm's owner", _A, "the arm is free when the client that has it is gone", _NONE),
    ("hold", _D, "Robot_Hold pauses a motion, Robot_Unhold continues it", _PROVIDER),
    ("hold", _A, "any client can hold a motion, also on RC7; the motion continues from standstill", _NONE),
    (
        "encoders",
        _A,
        "the encoders show the position that was commanded 24 ms earlier",
        f"joints behind their set points in {_SLIDES}",
    ),
    ("formats", _O, "slvSendFormat and slvRecvFormat choose the parts of slvMove", _DRIVER),
    ("formats", _A, "bit 0x400 of the send format 0x620 is accepted and changes nothing", _NONE),
    ("formats", _A, "without slvRecvFormat, slvMove returns a pose of the mode's type", _SLIDES),
    ("motions", _A, "motions follow the minimum-jerk curve, as fast as the limits of the axes allow", _NONE),
    (
        "motions",
        _A,
        "a line is executed like PTP; after @P the next motion begins at 70 % of the time",
        "ours",
    ),
    ("motions", _A, "a circle is executed like PTP to its second pose; a free curve has no motion", "ours"),
    ("robot", _A, "the robot is a simple arm of six axes, with limits and lengths of its own", _NONE),
    ("order of checks", _A, "the order of checks is emergency stop, errors, mode, token, motor, arm", _NONE),
    ("control log", _D, "each record of the control log has 39 values", f"{_SAMPLES}, Get_Syslog"),
    (
        "control log",
        _A,
        "the log has one record every 8 ms, at most 10,000; currents follow the encoders' lag",
        "ours",
    ),
)

_COMMANDS = (
    ("HandMove...", _D, "the hand has 0 to 30 mm, 1 to 100 % of 80 mm/s, 800 mm/s², 6 to 20 N", _GRIPPER),
    ("HandMove...", _D, "the hand moves only while the motor is on", _GRIPPER),
    ("HandMove...", _O, "the hand needs no TakeArm; in slave mode, another client may move it", _SAMPLES),
    (
        "HandMove...",
        _A,
        "the client in slave mode may not move the hand",
        f"no hand while the arm moves: {_ISSUES}, 13",
    ),
    ("HandMove...", _A, "a hand call lasts as long as its motion, unless the option is NEXT", _SAMPLES),
    ("HandMove...", _A, "Robot_Halt and every other stop of the arm also stop the hand", _NONE),
    ("HandMoveH", _A, "HandMoveH moves at 20 mm/s; the option DetectOn changes nothing", _NONE),
    (
        "HandMoveAH HandMoveRH",
        _A,
        "HandMoveAH and HandMoveRH grip an object on their way; reaching the width is no error",
        _SAMPLES,
    ),
    (
        "HandMoveVH",
        _A,
        "the power is 40 to 100 %, the pressure follows the power, the load is 50 %",
        _GRIPPER,
    ),
    (
        "HandChuck HandUnChuck",
        _A,
        "the hand moves at 50 % of the speed with 10 N, for every point number",
        _NONE,
    ),
    ("HandStop", _O, "HandStop stops the vacuum", _SAMPLES),
    ("HandStop", _A, "HandStop is accepted from every client, also in slave mode; a grip stays", _NONE),
    (
        "HandHoldState",
        _A,
        "HandHoldState is true while the fingers press on an object of the scenario",
        _SAMPLES,
    ),
    ("HandHoldState", _D, "without the motor's power the hand loses its grip", f"80500371 in the {_ERRORS}"),
    ("Hand0", _A, "the extension Hand0 is COBOTTA's hand, and its CurPos is the width", _NONE),
    (
        "HandGrip HandRelease",
        _A,
        "HandGrip and HandRelease move the 2FG hand, and return without waiting",
        _SCRIPTS,
    ),
    ("TwofgGrip", _D, "TwofgGrip accepts 20 to 140 N, 10 to 100 %, 1 to 39 mm", _SCRIPTS),
    ("TwofgGrip", _A, "TwofgGrip moves at 100 mm/s for 100 %; the hand grips from outside", _NONE),
    ("Dev DevH", _D, "Dev and DevH shift a pose in work or tool coordinates; Fig does not change", _SCRIPTS),
    ("Dev DevH", _A, "Dev turns a pose about fixed axes, and DevH about the pose's own axes", _NONE),
    ("CheckVirtualFence", _A, "CheckVirtualFence returns 0, because the simulator has no fences", "ours"),
    (
        "SetToolDef SetWorkDef",
        _A,
        "definitions of tools and works are stored and returned; CurPos does not change",
        "ours",
    ),
    ("ConvertPosWork", _A, "ConvertPosWork converts a pose from the first work to the second", _NONE),
    ("SyncTimeStart SyncTimeEnd", _A, "motions between start and end run at once", "there is one robot"),
    ("SyncMoveStart SyncMoveEnd", _A, "motions between start and end run at once", "there is one robot"),
    ("MotionSkip", _A, "MotionSkip stops the arm; the call of the motion returns S_OK", _SAMPLES),
    ("ForceCtrl", _D, "ForceCtrl needs TakeArm and the motor; its numbers are 1 to 10", _SCRIPTS),
    ("ForceCtrl ForceParam", _A, "ForceCtrl and ForceParam change no motion", "ours"),
    ("GetMotionPreparationState", _A, "GetMotionPreparationState returns true", "ours"),
    ("ForceValue CurForceSensorPayLoad", _A, "these commands return zeros", "ours"),
    (
        "GetMechaButtonState ClearMechaButtonState CurScene CurSubScene SceneInfo",
        _A,
        "these commands return zeros",
        "ours",
    ),
    ("SetAreaEnabled GetAreaEnabled", _A, "the areas 0 to 31 are stored; no area limits the robot", "ours"),
    ("Comm", _A, "every line of Comm can be opened, and receives nothing", "ours"),
    ("CalcPos", _A, "CalcPos counts from the first corner to the second, row by row to the third", _NONE),
    *((name, _A, "the command returns S_OK and has no effect", _NONE) for name in WITHOUT_EFFECT),
    ("results", _A, "results have the types that the catalogue of commands infers", "their meaning"),
    (
        'pose [1, "P", "@0"]',
        _O,
        "the number of a variable, its type and the pass can stand for a pose",
        "public clients",
    ),
    ("option SPEED=F2", _O, "the value of an option can be a variable such as F2", "public clients"),
    ("option ACCEL DECEL", _A, "ACCEL and DECEL are checked, and change nothing", "ours"),
    (
        "ManualResetPreparation",
        _A,
        "ManualResetPreparation is also accepted on the controller object",
        "a public client calls it there",
    ),
)

BEHAVIOURS: tuple[Behaviour, ...] = tuple(
    Behaviour(*row) for row in (*_PROFILE, *_RESULTS, *_OTHERS, *_COMMANDS)
)
"""Every simulated behaviour; behaviours that depend on the profile come first."""
