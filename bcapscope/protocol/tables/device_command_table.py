"""Commands of hands and of extension objects, in the form of `command_table`."""

from __future__ import annotations

from bcapscope.protocol.tables.command_row import (
    BRIDGES,
    COBOTTA,
    COBOTTA_PRO,
    COBOTTA_ROS,
    NKAWA,
    SAMPLES,
    CommandRow,
    changes,
    moves,
    reads,
)

DEVICE_COMMANDS: tuple[CommandRow, ...] = (
    moves(
        "HandMoveA HandMoveR: V[] R8[] I4[] -> -~",
        "moves the electric hand to, or by, a width",
        SAMPLES,
        "width or distance [mm], speed [%], NEXT",
        controllers=COBOTTA,
    ),
    moves(
        "HandMoveH: V[] -> -~",
        "grips with a force",
        f"{SAMPLES}; {COBOTTA_ROS} issue 22",
        "force [N], true closes and false opens, option",
        controllers=COBOTTA,
    ),
    moves(
        "HandMoveAH HandMoveRH: V[] R8[] I4[] -> -~",
        "moves the electric hand to, or by, a width and grips the object",
        f"{SAMPLES}; {BRIDGES}",
        "width or distance [mm], speed [%], force [N], NEXT",
        controllers=COBOTTA,
    ),
    moves(
        "HandMoveVH: V[] -> -~",
        "switches the vacuum hand",
        SAMPLES,
        "power [%], true draws in",
        controllers=COBOTTA,
    ),
    moves(
        "HandChuck HandUnChuck: - BSTR I4 -> -~",
        "closes or opens the hand",
        f"{COBOTTA_ROS} issue 22",
        controllers=COBOTTA,
    ),
    changes("HandStop: - BSTR -> -~", "stops the hand", SAMPLES, controllers=COBOTTA),
    reads(
        "HandHoldState: - BSTR -> BOOL~",
        "returns whether the hand holds something",
        f"{SAMPLES}; {BRIDGES}",
        controllers=COBOTTA,
    ),
    reads(
        "HandCurPos: - BSTR -> R8",
        "returns the hand's width",
        f"{SAMPLES}; {BRIDGES}",
        returns="width [mm]",
        controllers=COBOTTA,
    ),
    reads(
        "HandCurPressure HandCurLoad: - BSTR -> R8~",
        "returns the hand's pressure or load",
        SAMPLES,
        controllers=COBOTTA,
    ),
    moves("run: - BSTR V[] -> ~", "runs a vision program (EVP2 provider)", SAMPLES, controllers="EVP2"),
    moves("MoveA: V[] R8[] -> ~", "moves an electric hand (ESC11 provider)", SAMPLES, controllers="ESC11"),
)
"""Commands of Controller_Execute."""

GRIPPER_COMMANDS: tuple[CommandRow, ...] = (
    moves("HandGrip HandRelease: - BSTR -> -~", "moves the hand", NKAWA, controllers=COBOTTA_PRO),
    moves(
        "TwofgGrip: V[] -> -~",
        "moves the 2FG gripper",
        NKAWA,
        "width [mm], force [N], speed [%], wait 0/1",
        controllers=COBOTTA_PRO,
    ),
    moves(
        "TwofgRelease: V[] -> -~",
        "moves the 2FG gripper",
        NKAWA,
        "width [mm], wait 0/1",
        controllers=COBOTTA_PRO,
    ),
    changes("TwofgStop: - BSTR -> -~", "stops the 2FG gripper", NKAWA, controllers=COBOTTA_PRO),
    reads(
        "TwofgIsBusy: - BSTR -> I4",
        "returns whether the 2FG gripper moves",
        NKAWA,
        returns="0 or 1",
        controllers=COBOTTA_PRO,
    ),
    reads(
        "TwofgIsConn TwofgIsGrip TwofgGetErrorCode TwofgGetMode: - BSTR -> I4",
        "returns a state of the 2FG gripper",
        NKAWA,
        controllers=COBOTTA_PRO,
    ),
    reads(
        "TwofgGetWidth: - BSTR -> R8",
        "returns the 2FG gripper's width",
        NKAWA,
        returns="width [mm]",
        controllers=COBOTTA_PRO,
    ),
    reads(
        "TwofgGetMinWidth TwofgGetMaxWidth TwofgGetForce: - BSTR -> R8~",
        "returns a measure of the 2FG gripper",
        NKAWA,
        controllers=COBOTTA_PRO,
    ),
)
"""Commands of Robot_Execute."""

EXTENSION_COMMANDS: tuple[CommandRow, ...] = (
    reads("CurPos: - BSTR -> R8~", "returns the hand's position", SAMPLES, controllers="Hand0"),
    moves("Chuck UnChuck: I4 - BSTR -> -~", "moves the hand", SAMPLES, controllers="Hand0"),
    changes(
        "open close clear: I4 - BSTR V[] -> -~",
        "handles a serial or socket line",
        SAMPLES,
        "number of the line",
        controllers="Comm",
    ),
    reads(
        "State count: I4 - BSTR -> I4~",
        "describes a serial or socket line",
        SAMPLES,
        "number of the line",
        controllers="Comm",
    ),
    changes(
        "input: I4 - BSTR V[] -> BSTR~",
        "reads from a serial or socket line",
        SAMPLES,
        "number of the line",
        controllers="Comm",
    ),
    reads(
        "CalcPos: V[] -> R8[]~",
        "computes a place on a pallet",
        SAMPLES,
        "rows, columns, height [mm], four corners, place, layer",
        returns="X, Y, Z [mm], Rx, Ry, Rz [deg], Fig",
        controllers="Pallet",
    ),
)
"""Commands of Extension_Execute; `controllers` names the extension."""
