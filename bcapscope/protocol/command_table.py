"""Commands of Robot_Execute, Controller_Execute, Task_Execute and Extension_Execute met in public sources.

Data only; `commands` reads it. No paper lists them all, so each row names where it was seen. Types are
written short: `I4`, `I4[]` for an array, `V[]` for an array of VARIANT, `-` for EMPTY, `none` for no argument
at all, `pose` for any notation of a position; `~` after the result: its type was not printed by the source
but follows from the meaning.
"""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.effects import Effect

SLIDES = "DENSO Wave 2009, How to use the Slave mode"
SAMPLES = "ShoheiKobata/orin_bcap_python_samples"
ROS = "DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_robot.cpp"
DRIVER = "DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_controller.cpp"
NKAWA = "nkawa/Denso_CobottaPro900_MQTT_Control"
JSK = "start-jsk/denso denso_controller/src/main.cpp"
OTHER = "public robot code outside DENSO"

# The comments of `DRIVER` name what must not be called in slave mode, GetCurErrorCount among it.

CONTROLLER_EXECUTE, EXTENSION_EXECUTE, ROBOT_EXECUTE, TASK_EXECUTE = 17, 28, 64, 87


class Row(NamedTuple):
    """One command, or several that are used alike.

    Attributes:
        names: separated by blanks.
        parameter: accepted types.
        result: types of the result.
        text: what it does, one clause.
        effect: the most that it can do.
        source: where it was seen.
        elements: what a parameter with several elements holds, in order; else empty.
        returns: what the result holds; else empty.
        in_slave_mode: accepted while slave mode is on, refused, or None where nobody says.
        controllers: those that have it where that is known; else empty.
    """

    names: str
    parameter: str
    result: str
    text: str
    effect: Effect
    source: str
    elements: str = ""
    returns: str = ""
    in_slave_mode: bool | None = None
    controllers: str = ""


_R, _C, _E, _M = Effect.READS, Effect.CHANGES, Effect.ENERGISES, Effect.MOVES
_P = "X, Y, Z [mm], Rx, Ry, Rz [deg], Fig"
_J = "J1..J8 [deg, mm on linear axes]"
_T = "X, Y, Z [mm], Ox, Oy, Oz, Ax, Ay, Az, Fig"
_COBOTTA = "COBOTTA"
_RC8 = "RC8 and later"

ROBOT_COMMANDS: tuple[Row, ...] = (
    Row(
        "slvChangeMode",
        "I2 I4 BSTR",
        "none -",
        "switches slave mode: 0 off, else what a set point is and how slvMove answers",
        _E,
        f"{SLIDES}; {ROS}",
        "mode; in slave mode only 0 is accepted",
    ),
    Row("slvGetMode", "- BSTR", "I2 I4", "tells the slave mode", _R, SLIDES, "", "mode", True),
    Row(
        "slvMove",
        "R4[] R8[] V[]",
        "R4[] R8[] V[]",
        "sends one set point",
        _M,
        f"{SLIDES}; {ROS}",
        "pose, then I/O as the send format says",
        "pose now, or what the receive format says",
        True,
    ),
    Row(
        "slvSendFormat",
        "I4",
        "-~",
        "chooses what slvMove carries besides the pose",
        _C,
        f"{ROS}; {SAMPLES}",
        "format",
        controllers="RC8 from 1.4.0",
    ),
    Row(
        "slvRecvFormat",
        "I4 I4[]",
        "-~",
        "chooses what slvMove returns",
        _C,
        f"{ROS}; {SAMPLES}",
        "format, unit of the time stamp (0 ms, 1 us)",
        in_slave_mode=True,
        controllers=_RC8,
    ),
    Row(
        "TakeArm",
        "I4[] - BSTR",
        "-~",
        "takes the arm semaphore",
        _E,
        f"{SAMPLES}; {ROS}",
        "arm group 0..31, keep tool and work 0/1",
        in_slave_mode=False,
    ),
    Row("GiveArm", "- BSTR", "-~", "gives the arm semaphore back", _C, f"{SAMPLES}; {ROS}"),
    Row(
        "TakeArmState", "I4", "I4", "tells whether the arm is taken", _R, NKAWA, "arm group, -1 own", "0 or 1"
    ),
    Row(
        "Motor",
        "I4 I2 BSTR I4[]",
        "-~",
        "switches the motor on or off",
        _E,
        f"{SAMPLES}; {ROS}; {JSK}",
        "state 0/1, do not wait 0/1",
    ),
    Row(
        "ExtSpeed",
        "R8 R4 I4 R8[] R4[] BSTR",
        "-~",
        "sets external speed, acceleration and deceleration",
        _E,
        f"{SAMPLES}; {NKAWA}",
        "speed [%], acceleration, deceleration; -1 keeps, -2 is speed squared / 100",
    ),
    Row("CurPos", "- BSTR", "R8[]", "tells the position now", _R, SAMPLES, "", _P, True),
    Row("CurPosEx", "- BSTR", "R8[]", "tells the position now with its time", _R, NKAWA, "", f"t, {_P}"),
    Row("CurJnt", "- BSTR", "R8[]", "tells the joints now", _R, f"{SAMPLES}; {JSK}", "", _J, True),
    Row(
        "CurTrn", "- BSTR", "R8[]~", "tells the position now as T type", _R, "by analogy with CurPos", "", _T
    ),
    Row(
        "HighCurJntEx", "- BSTR", "R8[]", "tells the joints now with their time", _R, SAMPLES, "", f"t, {_J}"
    ),
    Row("DestPos", "- BSTR", "R8[]", "tells where the running motion ends", _R, SAMPLES, "", _P),
    Row("CurSpd CurAcc", "- BSTR", "R8~", "tells internal speed or acceleration", _R, NKAWA),
    Row(
        "CurExtSpd CurExtAcc",
        "- BSTR",
        "R8~",
        "tells external speed or acceleration",
        _R,
        f"{SAMPLES}; {NKAWA}",
    ),
    Row("CurTool", "- BSTR", "I4", "tells the tool number", _R, NKAWA),
    Row("GetToolDef", "I4", "R8[]", "tells a tool's definition", _R, NKAWA, "tool", _P),
    Row("SetToolDef", "V[]", "-~", "defines a tool", _C, NKAWA, "tool, pose as text"),
    Row("SetWorkDef", "V[]", "-~", "defines a work", _C, OTHER, "work, pose as text"),
    Row("ConvertPosWork", "V[]", "R8[]", "converts a pose between works", _R, OTHER, "pose, work, work", _P),
    Row(
        "Dev DevH",
        "V[] BSTR[]",
        "R8[]",
        "moves a pose by another, in work or tool coordinates; computes only",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "pose, deviation",
        _P,
    ),
    Row("J2P", "pose", "R8[]", "converts joints to P type", _R, SAMPLES, "joints", _P),
    Row("P2T", "pose", "R8[]", "converts P type to T type", _R, SAMPLES, "pose", _T),
    Row("T2J", "pose", "R8[]", "converts T type to joints", _R, SAMPLES, "pose, type of the result", _J),
    Row(
        "OutRange",
        "V[]",
        "I4",
        "tells whether a pose can be reached",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "pose, tool, work",
        "0 inside, 1..63 bits of the axes, -1 unreachable, -2 singular",
    ),
    Row(
        "CheckVirtualFence",
        "pose",
        "I4",
        "tells whether a pose violates a virtual fence",
        _R,
        SAMPLES,
        "pose",
    ),
    Row(
        "MotionComplete",
        "I4[]",
        "BOOL",
        "tells whether the motion is complete",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "arm group, 0 command or 1 motion",
    ),
    Row("MotionSkip", "I4[]", "-~", "drops the rest of the running motion", _M, NKAWA, "arm group, 0"),
    Row(
        "Approach",
        "V[]",
        "-~",
        "moves to a point before a pose",
        _M,
        SAMPLES,
        "interpolation, pose, distance",
    ),
    Row("Depart", "V[]", "-~", "moves away along the tool's axis", _M, SAMPLES, "interpolation, distance"),
    Row("DriveEx DriveAEx", "V[]", "-~", "moves axes by, or to, given values", _M, ROS, "axes, option"),
    Row(
        "GetSrvData",
        "I4",
        "R8[]~",
        "tells servo data",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "2 deviation, 4 torque, 17 tool speed",
        "one number per axis",
        True,
    ),
    Row("GetRobotTypeName", "- BSTR", "BSTR", "tells the robot's type name", _R, SAMPLES),
    Row("RobInfo", "I4", "BSTR~", "tells about the robot", _R, SAMPLES, "1"),
    Row("ClearLog StartLog StopLog", "- BSTR", "-~", "handles the control log", _C, f"{SLIDES}; {SAMPLES}"),
    Row("GetLogCount", "- BSTR", "I4", "tells how many records the control log has", _R, SAMPLES),
    Row("GetLogRecord", "I4", "V[]", "reads a record of the control log", _R, SAMPLES, "index", "39 values"),
    Row("PayLoad", "V[]", "-~", "sets the load", _C, SAMPLES, "mass [g], centre, inertia"),
    Row("SpeedMode", "I4", "-~", "sets the optimal speed mode", _E, SAMPLES),
    Row("HighPathAccuracy", "BOOL", "-~", "switches high path accuracy", _C, SAMPLES),
    Row("GrvOffset", "BOOL I4", "-~", "switches gravity offset", _C, SAMPLES),
    Row(
        "SyncTimeStart SyncTimeEnd SyncMoveStart SyncMoveEnd",
        "- BSTR",
        "-~",
        "brackets motions of several robots, which move together at the end",
        _M,
        SAMPLES,
    ),
    Row("AutoCal", "- BSTR", "-~", "calibrates the axes", _M, SAMPLES, controllers=_COBOTTA),
    Row(
        "ManualResetPreparation",
        "- BSTR",
        "-~",
        "prepares the reset of the safety state",
        _E,
        SAMPLES,
        controllers=_COBOTTA,
    ),
    Row("MotionPreparation", "- BSTR", "-~", "prepares for motion", _M, SAMPLES, controllers=_COBOTTA),
    Row(
        "GetMotionPreparationState",
        "- BSTR",
        "BOOL~",
        "tells whether motion is prepared",
        _R,
        OTHER,
        controllers=_COBOTTA,
    ),
    Row("GetMechaButtonState", "I4", "I4~", "tells a button on the arm", _R, SAMPLES, "button"),
    Row("ClearMechaButtonState", "I4", "I4~", "forgets a button on the arm", _C, SAMPLES, "button"),
    Row("CurScene CurSubScene", "- BSTR", "I4", "tells the safety scene", _R, NKAWA),
    Row("SceneInfo", "I4[]", "V[]~", "tells about a safety scene", _R, NKAWA, "scene, sub-scene"),
    Row("SetAreaEnabled", "V[]", "-~", "switches an area", _C, NKAWA, "area, on"),
    Row("GetAreaEnabled", "I4[]", "BOOL", "tells whether an area is on", _R, NKAWA, "area"),
    Row("ForceCtrl", "I4[]", "-~", "switches force control", _M, NKAWA, "on, number, mode"),
    Row("ForceParam", "V[]", "-~", "sets force control up", _C, f"{SAMPLES}; {NKAWA}", "up to 14 values"),
    Row("ForceValue", "I4[]", "R8[]", "tells forces and moments", _R, NKAWA, "13, 0", "6 or 7 numbers"),
    Row("ForceSensor", "I4", "-~", "resets the force sensor", _C, NKAWA),
    Row("CurForceSensorPayLoad", "- BSTR", "V[]", "tells the force sensor's load", _R, NKAWA),
    Row("ForceWaitCondition", "V[]", "-~", "waits for a force", _C, NKAWA),
    Row("HandGrip HandRelease", "- BSTR", "-~", "moves the hand", _M, NKAWA),
    Row("TwofgGrip TwofgRelease", "V[]", "-~", "moves the 2FG gripper", _M, NKAWA),
    Row("TwofgStop", "- BSTR", "-~", "stops the 2FG gripper", _C, NKAWA),
    Row("TwofgIsBusy", "- BSTR", "I4", "tells whether the 2FG gripper moves", _R, NKAWA),
    Row("TwofgGetWidth", "- BSTR", "R8", "tells the 2FG gripper's width", _R, NKAWA),
)

CONTROLLER_COMMANDS: tuple[Row, ...] = (
    Row("ClearError", "- BSTR I4", "-~", "clears the errors", _C, f"{SAMPLES}; {DRIVER}", "0", "", False),
    Row(
        "GetErrorDescription",
        "I4",
        "BSTR",
        "tells an error's text",
        _R,
        f"{SAMPLES}; {DRIVER}",
        "signed code",
        "",
        False,
    ),
    Row(
        "GetCurErrorCount",
        "- BSTR",
        "I4",
        "tells how many errors are active",
        _R,
        f"{SAMPLES}; {DRIVER}",
        "",
        "",
        False,
    ),
    Row(
        "GetCurErrorInfo",
        "I4",
        "V[]",
        "tells an active error",
        _R,
        f"{SAMPLES}; {NKAWA}; {DRIVER}",
        "index, 0 the newest",
        "code, message, sub-code, file and line, program, line, file, time on COBOTTA PRO",
        False,
    ),
    Row("GetErrorLogCount", "- BSTR", "I4", "tells how many errors are logged", _R, NKAWA),
    Row(
        "GetErrorLog",
        "I4",
        "V[]",
        "reads a logged error",
        _R,
        NKAWA,
        "index",
        "code, date and time in 8 numbers, ..., message at 12, original code at 13",
    ),
    Row("SysInfo", "I4", "BSTR", "tells about the system", _R, SAMPLES, "0 serial number, 15 battery date"),
    Row("SysState", "- BSTR", "I4", "tells the state as bits", _R, f"{SAMPLES}; {NKAWA}", "", "bits", False),
    Row("StoState", "- BSTR", "BOOL", "tells whether safe torque off is active", _R, SAMPLES),
    Row(
        "ManualReset",
        "- BSTR",
        "-~",
        "resets the safety state",
        _E,
        SAMPLES,
        in_slave_mode=True,
        controllers="RC9",
    ),
    Row("ResetStoState", "- BSTR", "-~", "leaves safe torque off", _E, ROS, controllers="RC9"),
    Row(
        "PutAutoMode",
        "I2",
        "-~",
        "chooses automatic mode",
        _E,
        OTHER,
        "1 internal, 2 external",
        "",
        None,
        "RC7",
    ),
    Row("GetAutoMode", "-", "I2 I4", "tells the automatic mode", _R, SLIDES, "", "1 or 2", None, "RC7"),
    Row(
        "HandMoveA HandMoveR",
        "V[] R8[]",
        "-~",
        "moves the electric hand to, or by, a width",
        _M,
        SAMPLES,
        "position or distance, speed",
        controllers=_COBOTTA,
    ),
    Row(
        "HandMoveH",
        "V[]",
        "-~",
        "grips with a force",
        _M,
        SAMPLES,
        "force, direction",
        controllers=_COBOTTA,
    ),
    Row(
        "HandMoveAH HandMoveVH",
        "V[]",
        "-~",
        "moves the electric hand and grips",
        _M,
        SAMPLES,
        controllers=_COBOTTA,
    ),
    Row("HandStop", "- BSTR", "-~", "stops the hand", _C, SAMPLES, controllers=_COBOTTA),
    Row(
        "HandCurPressure HandCurLoad",
        "- BSTR",
        "R8~",
        "tells the hand's pressure or load",
        _R,
        SAMPLES,
        controllers=_COBOTTA,
    ),
    Row("run", "- BSTR V[]", "~", "runs a vision program (EVP2 provider)", _M, SAMPLES, controllers="EVP2"),
    Row(
        "MoveA", "V[] R8[]", "~", "moves an electric hand (ESC11 provider)", _M, SAMPLES, controllers="ESC11"
    ),
)

TASK_COMMANDS: tuple[Row, ...] = (
    Row("GetStatus", "- BSTR", "I4", "tells the task's state", _R, SAMPLES, "", "0..4"),
)

EXTENSION_COMMANDS: tuple[Row, ...] = (
    Row("CurPos", "- BSTR", "R8~", "tells the hand's position", _R, SAMPLES, controllers="Hand0"),
    Row("Chuck UnChuck", "I4 - BSTR", "-~", "moves the hand", _M, SAMPLES, controllers="Hand0"),
    Row(
        "open close clear",
        "- BSTR V[]",
        "-~",
        "handles a serial or socket line",
        _C,
        SAMPLES,
        controllers="Comm",
    ),
    Row(
        "State count", "- BSTR", "I4~", "tells about a serial or socket line", _R, SAMPLES, controllers="Comm"
    ),
    Row(
        "input", "- BSTR V[]", "BSTR~", "takes from a serial or socket line", _C, SAMPLES, controllers="Comm"
    ),
    Row("CalcPos", "V[] I4", "R8[]~", "computes a place on a pallet", _R, SAMPLES, controllers="Pallet"),
)

ROWS: dict[int, tuple[Row, ...]] = {
    CONTROLLER_EXECUTE: CONTROLLER_COMMANDS,
    EXTENSION_EXECUTE: EXTENSION_COMMANDS,
    ROBOT_EXECUTE: ROBOT_COMMANDS,
    TASK_EXECUTE: TASK_COMMANDS,
}
