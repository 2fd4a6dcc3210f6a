"""Commands of Robot_Execute, Controller_Execute, Task_Execute and Extension_Execute in public sources.

Data only; `command_catalogue` reads it. No paper lists all commands, so each row names its source. Types have
short names: `I4`, `I4[]` for an array, `V[]` for an array of VARIANT, `-` for EMPTY, `none` for no argument
at all, `pose` for any notation of a position. A `~` after a result type marks a type that the source does not
print and bcapscope infers from the meaning.
"""

from __future__ import annotations

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
    changes,
    energises,
    moves,
    reads,
)
from bcapscope.protocol.tables.device_command_table import (
    DEVICE_COMMANDS,
    EXTENSION_COMMANDS,
    GRIPPER_COMMANDS,
)

# The comments in the source `DRIVER` list the commands that a client must not call in slave mode, such as
# GetCurErrorCount.

CONTROLLER_EXECUTE, EXTENSION_EXECUTE, ROBOT_EXECUTE, TASK_EXECUTE = 17, 28, 64, 87


_P = "X, Y, Z [mm], Rx, Ry, Rz [deg], Fig"
_J = "J1..J8 [deg, mm on linear axes]"
_T = "X, Y, Z [mm], Ox, Oy, Oz, Ax, Ay, Az, Fig"
_RC8 = "RC8 and later"

ROBOT_COMMANDS: tuple[CommandRow, ...] = (
    energises(
        "slvChangeMode: I2 I4 BSTR -> none -",
        "switches slave mode: 0 off, else what a set point is and how slvMove answers",
        f"{SLIDES}; {ROS}",
        "mode; in slave mode only 0 is accepted",
    ),
    reads(
        "slvGetMode: - BSTR -> I2 I4", "returns the slave mode", SLIDES, returns="mode", in_slave_mode=True
    ),
    moves(
        "slvMove: R4[] R8[] V[] -> R4[] R8[] V[]",
        "sends one set point",
        f"{SLIDES}; {ROS}",
        "pose, then I/O as the send format says",
        returns="pose now, or what the receive format says",
        in_slave_mode=True,
    ),
    changes(
        "slvSendFormat: I4 -> -~",
        "chooses what slvMove carries besides the pose",
        f"{ROS}; {SAMPLES}",
        "format",
        controllers="RC8 from 1.4.0",
    ),
    changes(
        "slvRecvFormat: I4 I4[] -> -~",
        "chooses what slvMove returns",
        f"{ROS}; {SAMPLES}",
        "format, unit of the time stamp (0 ms, 1 us)",
        in_slave_mode=True,
        controllers=_RC8,
    ),
    energises(
        "TakeArm: I4[] - BSTR -> -~",
        "takes the arm semaphore",
        f"{SAMPLES}; {ROS}",
        "arm group 0..31, keep tool and work 0/1",
        in_slave_mode=False,
    ),
    changes("GiveArm: - BSTR -> -~", "gives the arm semaphore back", f"{SAMPLES}; {ROS}"),
    reads(
        "TakeArmState: I4 -> I4",
        "returns whether the arm is taken",
        NKAWA,
        "arm group, -1 own",
        returns="0 or 1",
    ),
    energises(
        "Motor: I4 I2 BSTR I4[] -> -~",
        "switches the motor on or off",
        f"{SAMPLES}; {ROS}; {JSK}",
        "state 0/1, do not wait 0/1",
    ),
    energises(
        "ExtSpeed: R8 R4 I4 R8[] R4[] BSTR -> -~",
        "sets external speed, acceleration and deceleration",
        f"{SAMPLES}; {NKAWA}",
        "speed [%], acceleration, deceleration; -1 keeps, -2 is speed squared / 100",
    ),
    reads("CurPos: - BSTR -> R8[]", "returns the position now", SAMPLES, returns=_P, in_slave_mode=True),
    reads("CurPosEx: - BSTR -> R8[]", "returns the position now with its time", NKAWA, returns=f"t, {_P}"),
    reads(
        "CurJnt: - BSTR -> R8[]",
        "returns the joints now",
        f"{SAMPLES}; {JSK}",
        returns=_J,
        in_slave_mode=True,
    ),
    reads(
        "CurTrn: - BSTR -> R8[]~", "returns the position now as T type", "by analogy with CurPos", returns=_T
    ),
    reads(
        "HighCurJntEx: - BSTR -> R8[]", "returns the joints now with their time", SAMPLES, returns=f"t, {_J}"
    ),
    reads("DestPos: - BSTR -> R8[]", "returns where the running motion ends", SAMPLES, returns=_P),
    reads("CurSpd CurAcc: - BSTR -> R8~", "returns internal speed or acceleration", NKAWA),
    reads(
        "CurExtSpd CurExtAcc: - BSTR -> R8~", "returns external speed or acceleration", f"{SAMPLES}; {NKAWA}"
    ),
    reads("CurTool: - BSTR -> I4", "returns the tool number", NKAWA),
    reads("GetToolDef: I4 -> R8[]", "returns a tool's definition", NKAWA, "tool", returns=_P),
    changes("SetToolDef: V[] -> -~", "defines a tool", NKAWA, "tool, pose as text"),
    changes("SetWorkDef: V[] -> -~", "defines a work", OTHER, "work, pose as text"),
    reads(
        "ConvertPosWork: V[] -> R8[]", "converts a pose between works", OTHER, "pose, work, work", returns=_P
    ),
    reads(
        "Dev DevH: V[] BSTR[] -> R8[]",
        "moves a pose by another, in work or tool coordinates; computes only",
        f"{SAMPLES}; {NKAWA}",
        "pose, deviation",
        returns=_P,
    ),
    reads("J2P: pose -> R8[]", "converts joints to P type", SAMPLES, "joints", returns=_P),
    reads("P2T: pose -> R8[]", "converts P type to T type", SAMPLES, "pose", returns=_T),
    reads("T2J: pose -> R8[]", "converts T type to joints", SAMPLES, "pose, type of the result", returns=_J),
    reads(
        "OutRange: V[] -> I4",
        "returns whether a pose can be reached",
        f"{SAMPLES}; {NKAWA}",
        "pose, tool, work",
        returns="0 inside, 1..63 bits of the axes, -1 unreachable, -2 singular",
    ),
    reads(
        "CheckVirtualFence: pose -> I4", "returns whether a pose violates a virtual fence", SAMPLES, "pose"
    ),
    reads(
        "MotionComplete: I4[] -> BOOL",
        "returns whether the motion is complete",
        f"{SAMPLES}; {NKAWA}",
        "arm group, 0 command or 1 motion",
    ),
    moves("MotionSkip: I4[] -> -~", "drops the rest of the running motion", NKAWA, "arm group, 0"),
    moves("Approach: V[] -> -~", "moves to a point before a pose", SAMPLES, "interpolation, pose, distance"),
    moves("Depart: V[] -> -~", "moves away along the tool's axis", SAMPLES, "interpolation, distance"),
    moves(
        "DriveEx DriveAEx: V[] BSTR[] BSTR -> -~", "moves axes by, or to, given values", ROS, "axes, option"
    ),
    reads(
        "GetSrvData: I4 -> R8[]~",
        "returns servo data",
        f"{SAMPLES}; {NKAWA}",
        "2 deviation, 4 torque, 17 tool speed",
        returns="one number per axis",
        in_slave_mode=True,
    ),
    reads("GetRobotTypeName: - BSTR -> BSTR", "returns the robot's type name", SAMPLES),
    reads("RobInfo: I4 -> BSTR~", "describes the robot", SAMPLES, "1"),
    changes("ClearLog StartLog StopLog: - BSTR -> -~", "handles the control log", f"{SLIDES}; {SAMPLES}"),
    reads("GetLogCount: - BSTR -> I4", "returns how many records the control log has", SAMPLES),
    reads(
        "GetLogRecord: I4 -> V[]", "reads a record of the control log", SAMPLES, "index", returns="39 values"
    ),
    changes("PayLoad: V[] -> -~", "sets the load", SAMPLES, "mass [g], centre, inertia"),
    energises("SpeedMode: I4 -> -~", "sets the optimal speed mode", SAMPLES),
    changes("HighPathAccuracy: BOOL -> -~", "switches high path accuracy", SAMPLES),
    changes("GrvOffset: BOOL I4 -> -~", "switches gravity offset", SAMPLES),
    moves(
        "SyncTimeStart SyncTimeEnd SyncMoveStart SyncMoveEnd: - BSTR I4 -> -~",
        "brackets motions of several robots, which move together at the end",
        SAMPLES,
    ),
    moves("AutoCal: - BSTR -> -~", "calibrates the axes", SAMPLES, controllers=COBOTTA),
    energises(
        "ManualResetPreparation: - BSTR -> -~",
        "prepares the reset of the safety state",
        SAMPLES,
        controllers=COBOTTA,
    ),
    moves("MotionPreparation: - BSTR -> -~", "prepares for motion", SAMPLES, controllers=COBOTTA),
    reads(
        "GetMotionPreparationState: - BSTR -> BOOL~",
        "returns whether motion is prepared",
        OTHER,
        controllers=COBOTTA,
    ),
    reads(
        "GetMechaButtonState: I4 -> I4~",
        "returns the state of a button on the arm",
        SAMPLES,
        "button",
        controllers=COBOTTA,
    ),
    changes(
        "ClearMechaButtonState: I4 -> I4~",
        "clears the state of a button on the arm",
        SAMPLES,
        "button",
        controllers=COBOTTA,
    ),
    reads("CurScene CurSubScene: - BSTR -> I4", "returns the safety scene", NKAWA),
    reads("SceneInfo: I4[] -> V[]~", "describes a safety scene", NKAWA, "scene, sub-scene"),
    changes("SetAreaEnabled: V[] -> -~", "switches an area", NKAWA, "area, on", in_slave_mode=False),
    reads("GetAreaEnabled: I4[] -> BOOL", "returns whether an area is on", NKAWA, "area"),
    moves("ForceCtrl: I4[] -> -~", "switches force control", NKAWA, "on, number, mode"),
    changes("ForceParam: V[] -> -~", "sets force control up", f"{SAMPLES}; {NKAWA}", "up to 14 values"),
    reads("ForceValue: I4[] -> R8[]", "returns forces and moments", NKAWA, "13, 0", returns="6 or 7 numbers"),
    changes("ForceSensor: I4 I4[] -> -~", "resets the force sensor", NKAWA),
    reads("CurForceSensorPayLoad: - BSTR -> V[]", "returns the force sensor's load", NKAWA),
    changes("ForceWaitCondition: V[] -> -~", "waits for a force", NKAWA),
    *GRIPPER_COMMANDS,
)

CONTROLLER_COMMANDS: tuple[CommandRow, ...] = (
    changes(
        "ClearError: - BSTR I4 -> -~", "clears the errors", f"{SAMPLES}; {DRIVER}", "0", in_slave_mode=False
    ),
    reads(
        "GetErrorDescription: I4 -> BSTR",
        "returns an error's text",
        f"{SAMPLES}; {DRIVER}",
        "signed code",
        in_slave_mode=False,
    ),
    reads(
        "GetCurErrorCount: - BSTR -> I4",
        "returns how many errors are active",
        f"{SAMPLES}; {DRIVER}",
        in_slave_mode=False,
    ),
    reads(
        "GetCurErrorInfo: I4 -> V[]",
        "returns an active error",
        f"{SAMPLES}; {NKAWA}; {DRIVER}",
        "index, 0 the newest",
        returns="code, message, sub-code, file and line, program, line, file, time on COBOTTA PRO",
        in_slave_mode=False,
    ),
    reads("GetErrorLogCount: - BSTR -> I4", "returns how many errors are logged", NKAWA),
    reads(
        "GetErrorLog: I4 -> V[]",
        "reads a logged error",
        NKAWA,
        "index",
        returns="code, date and time in 8 numbers, ..., message at 12, original code at 13",
    ),
    reads("SysInfo: I4 -> BSTR", "describes the system", SAMPLES, "0 serial number, 15 battery date"),
    reads(
        "SysState: - BSTR -> I4",
        "returns the state as bits",
        f"{SAMPLES}; {NKAWA}",
        returns="bits",
        in_slave_mode=False,
    ),
    reads("StoState: - BSTR -> BOOL", "returns whether safe torque off is active", SAMPLES),
    energises(
        "ManualReset: - BSTR -> -~", "resets the safety state", SAMPLES, in_slave_mode=True, controllers="RC9"
    ),
    energises("ManualResetPreparation: - BSTR -> -~", "prepares the reset of the safety state", OTHER),
    energises("ResetStoState: - BSTR -> -~", "leaves safe torque off", ROS, controllers="RC9"),
    energises(
        "PutAutoMode: I2 -> -~", "chooses automatic mode", OTHER, "1 internal, 2 external", controllers="RC7"
    ),
    reads(
        "GetAutoMode: - -> I2 I4", "returns the automatic mode", SLIDES, returns="1 or 2", controllers="RC7"
    ),
    *DEVICE_COMMANDS,
)

TASK_COMMANDS: tuple[CommandRow, ...] = (
    reads("GetStatus: - BSTR -> I4", "returns the task's state", SAMPLES, returns="0..4"),
)

COMMAND_ROWS: dict[int, tuple[CommandRow, ...]] = {
    CONTROLLER_EXECUTE: CONTROLLER_COMMANDS,
    EXTENSION_EXECUTE: EXTENSION_COMMANDS,
    ROBOT_EXECUTE: ROBOT_COMMANDS,
    TASK_EXECUTE: TASK_COMMANDS,
}
