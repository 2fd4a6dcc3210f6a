"""Commands of Robot_Execute, Controller_Execute, Task_Execute and Extension_Execute in public sources.

Data only; `command_catalogue` reads it. No paper lists them all, so each row names its source. Types have
short names: `I4`, `I4[]` for an array, `V[]` for an array of VARIANT, `-` for EMPTY, `none` for no argument
at all, `pose` for any notation of a position. A result with `~` has a type that the source does not print; it
is inferred from the meaning.
"""

from __future__ import annotations

from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_row import (
    COBOTTA,
    DRIVER,
    JSK,
    NKAWA,
    OTHER,
    ROS,
    SAMPLES,
    SLIDES,
    CommandRow,
)
from bcapscope.protocol.tables.device_command_table import (
    DEVICE_COMMANDS,
    EXTENSION_COMMANDS,
    GRIPPER_COMMANDS,
)

# The comments of `DRIVER` list what must not be called in slave mode, including GetCurErrorCount.

CONTROLLER_EXECUTE, EXTENSION_EXECUTE, ROBOT_EXECUTE, TASK_EXECUTE = 17, 28, 64, 87


_R, _C, _E, _M = CallEffect.READS, CallEffect.CHANGES, CallEffect.ENERGISES, CallEffect.MOVES
_P = "X, Y, Z [mm], Rx, Ry, Rz [deg], Fig"
_J = "J1..J8 [deg, mm on linear axes]"
_T = "X, Y, Z [mm], Ox, Oy, Oz, Ax, Ay, Az, Fig"
_RC8 = "RC8 and later"

ROBOT_COMMANDS: tuple[CommandRow, ...] = (
    CommandRow(
        "slvChangeMode",
        "I2 I4 BSTR",
        "none -",
        "switches slave mode: 0 off, else what a set point is and how slvMove answers",
        _E,
        f"{SLIDES}; {ROS}",
        "mode; in slave mode only 0 is accepted",
    ),
    CommandRow("slvGetMode", "- BSTR", "I2 I4", "returns the slave mode", _R, SLIDES, "", "mode", True),
    CommandRow(
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
    CommandRow(
        "slvSendFormat",
        "I4",
        "-~",
        "chooses what slvMove carries besides the pose",
        _C,
        f"{ROS}; {SAMPLES}",
        "format",
        controllers="RC8 from 1.4.0",
    ),
    CommandRow(
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
    CommandRow(
        "TakeArm",
        "I4[] - BSTR",
        "-~",
        "takes the arm semaphore",
        _E,
        f"{SAMPLES}; {ROS}",
        "arm group 0..31, keep tool and work 0/1",
        in_slave_mode=False,
    ),
    CommandRow("GiveArm", "- BSTR", "-~", "gives the arm semaphore back", _C, f"{SAMPLES}; {ROS}"),
    CommandRow(
        "TakeArmState",
        "I4",
        "I4",
        "returns whether the arm is taken",
        _R,
        NKAWA,
        "arm group, -1 own",
        "0 or 1",
    ),
    CommandRow(
        "Motor",
        "I4 I2 BSTR I4[]",
        "-~",
        "switches the motor on or off",
        _E,
        f"{SAMPLES}; {ROS}; {JSK}",
        "state 0/1, do not wait 0/1",
    ),
    CommandRow(
        "ExtSpeed",
        "R8 R4 I4 R8[] R4[] BSTR",
        "-~",
        "sets external speed, acceleration and deceleration",
        _E,
        f"{SAMPLES}; {NKAWA}",
        "speed [%], acceleration, deceleration; -1 keeps, -2 is speed squared / 100",
    ),
    CommandRow("CurPos", "- BSTR", "R8[]", "returns the position now", _R, SAMPLES, "", _P, True),
    CommandRow(
        "CurPosEx", "- BSTR", "R8[]", "returns the position now with its time", _R, NKAWA, "", f"t, {_P}"
    ),
    CommandRow("CurJnt", "- BSTR", "R8[]", "returns the joints now", _R, f"{SAMPLES}; {JSK}", "", _J, True),
    CommandRow(
        "CurTrn",
        "- BSTR",
        "R8[]~",
        "returns the position now as T type",
        _R,
        "by analogy with CurPos",
        "",
        _T,
    ),
    CommandRow(
        "HighCurJntEx",
        "- BSTR",
        "R8[]",
        "returns the joints now with their time",
        _R,
        SAMPLES,
        "",
        f"t, {_J}",
    ),
    CommandRow("DestPos", "- BSTR", "R8[]", "returns where the running motion ends", _R, SAMPLES, "", _P),
    CommandRow("CurSpd CurAcc", "- BSTR", "R8~", "returns internal speed or acceleration", _R, NKAWA),
    CommandRow(
        "CurExtSpd CurExtAcc",
        "- BSTR",
        "R8~",
        "returns external speed or acceleration",
        _R,
        f"{SAMPLES}; {NKAWA}",
    ),
    CommandRow("CurTool", "- BSTR", "I4", "returns the tool number", _R, NKAWA),
    CommandRow("GetToolDef", "I4", "R8[]", "returns a tool's definition", _R, NKAWA, "tool", _P),
    CommandRow("SetToolDef", "V[]", "-~", "defines a tool", _C, NKAWA, "tool, pose as text"),
    CommandRow("SetWorkDef", "V[]", "-~", "defines a work", _C, OTHER, "work, pose as text"),
    CommandRow(
        "ConvertPosWork", "V[]", "R8[]", "converts a pose between works", _R, OTHER, "pose, work, work", _P
    ),
    CommandRow(
        "Dev DevH",
        "V[] BSTR[]",
        "R8[]",
        "moves a pose by another, in work or tool coordinates; computes only",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "pose, deviation",
        _P,
    ),
    CommandRow("J2P", "pose", "R8[]", "converts joints to P type", _R, SAMPLES, "joints", _P),
    CommandRow("P2T", "pose", "R8[]", "converts P type to T type", _R, SAMPLES, "pose", _T),
    CommandRow(
        "T2J", "pose", "R8[]", "converts T type to joints", _R, SAMPLES, "pose, type of the result", _J
    ),
    CommandRow(
        "OutRange",
        "V[]",
        "I4",
        "returns whether a pose can be reached",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "pose, tool, work",
        "0 inside, 1..63 bits of the axes, -1 unreachable, -2 singular",
    ),
    CommandRow(
        "CheckVirtualFence",
        "pose",
        "I4",
        "returns whether a pose violates a virtual fence",
        _R,
        SAMPLES,
        "pose",
    ),
    CommandRow(
        "MotionComplete",
        "I4[]",
        "BOOL",
        "returns whether the motion is complete",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "arm group, 0 command or 1 motion",
    ),
    CommandRow("MotionSkip", "I4[]", "-~", "drops the rest of the running motion", _M, NKAWA, "arm group, 0"),
    CommandRow(
        "Approach",
        "V[]",
        "-~",
        "moves to a point before a pose",
        _M,
        SAMPLES,
        "interpolation, pose, distance",
    ),
    CommandRow(
        "Depart", "V[]", "-~", "moves away along the tool's axis", _M, SAMPLES, "interpolation, distance"
    ),
    CommandRow(
        "DriveEx DriveAEx",
        "V[] BSTR[] BSTR",
        "-~",
        "moves axes by, or to, given values",
        _M,
        ROS,
        "axes, option",
    ),
    CommandRow(
        "GetSrvData",
        "I4",
        "R8[]~",
        "returns servo data",
        _R,
        f"{SAMPLES}; {NKAWA}",
        "2 deviation, 4 torque, 17 tool speed",
        "one number per axis",
        True,
    ),
    CommandRow("GetRobotTypeName", "- BSTR", "BSTR", "returns the robot's type name", _R, SAMPLES),
    CommandRow("RobInfo", "I4", "BSTR~", "describes the robot", _R, SAMPLES, "1"),
    CommandRow(
        "ClearLog StartLog StopLog", "- BSTR", "-~", "handles the control log", _C, f"{SLIDES}; {SAMPLES}"
    ),
    CommandRow("GetLogCount", "- BSTR", "I4", "returns how many records the control log has", _R, SAMPLES),
    CommandRow(
        "GetLogRecord", "I4", "V[]", "reads a record of the control log", _R, SAMPLES, "index", "39 values"
    ),
    CommandRow("PayLoad", "V[]", "-~", "sets the load", _C, SAMPLES, "mass [g], centre, inertia"),
    CommandRow("SpeedMode", "I4", "-~", "sets the optimal speed mode", _E, SAMPLES),
    CommandRow("HighPathAccuracy", "BOOL", "-~", "switches high path accuracy", _C, SAMPLES),
    CommandRow("GrvOffset", "BOOL I4", "-~", "switches gravity offset", _C, SAMPLES),
    CommandRow(
        "SyncTimeStart SyncTimeEnd SyncMoveStart SyncMoveEnd",
        "- BSTR I4",
        "-~",
        "brackets motions of several robots, which move together at the end",
        _M,
        SAMPLES,
    ),
    CommandRow("AutoCal", "- BSTR", "-~", "calibrates the axes", _M, SAMPLES, controllers=COBOTTA),
    CommandRow(
        "ManualResetPreparation",
        "- BSTR",
        "-~",
        "prepares the reset of the safety state",
        _E,
        SAMPLES,
        controllers=COBOTTA,
    ),
    CommandRow("MotionPreparation", "- BSTR", "-~", "prepares for motion", _M, SAMPLES, controllers=COBOTTA),
    CommandRow(
        "GetMotionPreparationState",
        "- BSTR",
        "BOOL~",
        "returns whether motion is prepared",
        _R,
        OTHER,
        controllers=COBOTTA,
    ),
    CommandRow(
        "GetMechaButtonState",
        "I4",
        "I4~",
        "returns the state of a button on the arm",
        _R,
        SAMPLES,
        "button",
        controllers=COBOTTA,
    ),
    CommandRow(
        "ClearMechaButtonState",
        "I4",
        "I4~",
        "clears the state of a button on the arm",
        _C,
        SAMPLES,
        "button",
        controllers=COBOTTA,
    ),
    CommandRow("CurScene CurSubScene", "- BSTR", "I4", "returns the safety scene", _R, NKAWA),
    CommandRow("SceneInfo", "I4[]", "V[]~", "describes a safety scene", _R, NKAWA, "scene, sub-scene"),
    CommandRow("SetAreaEnabled", "V[]", "-~", "switches an area", _C, NKAWA, "area, on", "", False),
    CommandRow("GetAreaEnabled", "I4[]", "BOOL", "returns whether an area is on", _R, NKAWA, "area"),
    CommandRow("ForceCtrl", "I4[]", "-~", "switches force control", _M, NKAWA, "on, number, mode"),
    CommandRow(
        "ForceParam", "V[]", "-~", "sets force control up", _C, f"{SAMPLES}; {NKAWA}", "up to 14 values"
    ),
    CommandRow(
        "ForceValue", "I4[]", "R8[]", "returns forces and moments", _R, NKAWA, "13, 0", "6 or 7 numbers"
    ),
    CommandRow("ForceSensor", "I4 I4[]", "-~", "resets the force sensor", _C, NKAWA),
    CommandRow("CurForceSensorPayLoad", "- BSTR", "V[]", "returns the force sensor's load", _R, NKAWA),
    CommandRow("ForceWaitCondition", "V[]", "-~", "waits for a force", _C, NKAWA),
    *GRIPPER_COMMANDS,
)

CONTROLLER_COMMANDS: tuple[CommandRow, ...] = (
    CommandRow(
        "ClearError", "- BSTR I4", "-~", "clears the errors", _C, f"{SAMPLES}; {DRIVER}", "0", "", False
    ),
    CommandRow(
        "GetErrorDescription",
        "I4",
        "BSTR",
        "returns an error's text",
        _R,
        f"{SAMPLES}; {DRIVER}",
        "signed code",
        "",
        False,
    ),
    CommandRow(
        "GetCurErrorCount",
        "- BSTR",
        "I4",
        "returns how many errors are active",
        _R,
        f"{SAMPLES}; {DRIVER}",
        "",
        "",
        False,
    ),
    CommandRow(
        "GetCurErrorInfo",
        "I4",
        "V[]",
        "returns an active error",
        _R,
        f"{SAMPLES}; {NKAWA}; {DRIVER}",
        "index, 0 the newest",
        "code, message, sub-code, file and line, program, line, file, time on COBOTTA PRO",
        False,
    ),
    CommandRow("GetErrorLogCount", "- BSTR", "I4", "returns how many errors are logged", _R, NKAWA),
    CommandRow(
        "GetErrorLog",
        "I4",
        "V[]",
        "reads a logged error",
        _R,
        NKAWA,
        "index",
        "code, date and time in 8 numbers, ..., message at 12, original code at 13",
    ),
    CommandRow(
        "SysInfo", "I4", "BSTR", "describes the system", _R, SAMPLES, "0 serial number, 15 battery date"
    ),
    CommandRow(
        "SysState", "- BSTR", "I4", "returns the state as bits", _R, f"{SAMPLES}; {NKAWA}", "", "bits", False
    ),
    CommandRow("StoState", "- BSTR", "BOOL", "returns whether safe torque off is active", _R, SAMPLES),
    CommandRow(
        "ManualReset",
        "- BSTR",
        "-~",
        "resets the safety state",
        _E,
        SAMPLES,
        in_slave_mode=True,
        controllers="RC9",
    ),
    CommandRow(
        "ManualResetPreparation",
        "- BSTR",
        "-~",
        "prepares the reset of the safety state",
        _E,
        OTHER,
    ),
    CommandRow("ResetStoState", "- BSTR", "-~", "leaves safe torque off", _E, ROS, controllers="RC9"),
    CommandRow(
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
    CommandRow(
        "GetAutoMode", "-", "I2 I4", "returns the automatic mode", _R, SLIDES, "", "1 or 2", None, "RC7"
    ),
    *DEVICE_COMMANDS,
)

TASK_COMMANDS: tuple[CommandRow, ...] = (
    CommandRow("GetStatus", "- BSTR", "I4", "returns the task's state", _R, SAMPLES, "", "0..4"),
)

COMMAND_ROWS: dict[int, tuple[CommandRow, ...]] = {
    CONTROLLER_EXECUTE: CONTROLLER_COMMANDS,
    EXTENSION_EXECUTE: EXTENSION_COMMANDS,
    ROBOT_EXECUTE: ROBOT_COMMANDS,
    TASK_EXECUTE: TASK_COMMANDS,
}
