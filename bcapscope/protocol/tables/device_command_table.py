"""Commands of hands and of extension objects; data only, as in `command_table`."""

from __future__ import annotations

from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_row import (
    BRIDGES,
    COBOTTA,
    COBOTTA_PRO,
    COBOTTA_ROS,
    NKAWA,
    SAMPLES,
    CommandRow,
)

_R, _C, _M = CallEffect.READS, CallEffect.CHANGES, CallEffect.MOVES

DEVICE_COMMANDS: tuple[CommandRow, ...] = (
    CommandRow(
        "HandMoveA HandMoveR",
        "V[] R8[] I4[]",
        "-~",
        "moves the electric hand to, or by, a width",
        _M,
        SAMPLES,
        "width or distance [mm], speed [%], NEXT",
        controllers=COBOTTA,
    ),
    CommandRow(
        "HandMoveH",
        "V[]",
        "-~",
        "grips with a force",
        _M,
        f"{SAMPLES}; {COBOTTA_ROS} issue 22",
        "force [N], true closes and false opens, option",
        controllers=COBOTTA,
    ),
    CommandRow(
        "HandMoveAH HandMoveRH",
        "V[] R8[] I4[]",
        "-~",
        "moves the electric hand to, or by, a width and grips the object",
        _M,
        f"{SAMPLES}; {BRIDGES}",
        "width or distance [mm], speed [%], force [N], NEXT",
        controllers=COBOTTA,
    ),
    CommandRow(
        "HandMoveVH",
        "V[]",
        "-~",
        "switches the vacuum hand",
        _M,
        SAMPLES,
        "power [%], true draws in",
        controllers=COBOTTA,
    ),
    CommandRow(
        "HandChuck HandUnChuck",
        "- BSTR I4",
        "-~",
        "closes or opens the hand",
        _M,
        f"{COBOTTA_ROS} issue 22",
        controllers=COBOTTA,
    ),
    CommandRow("HandStop", "- BSTR", "-~", "stops the hand", _C, SAMPLES, controllers=COBOTTA),
    CommandRow(
        "HandHoldState",
        "- BSTR",
        "BOOL~",
        "returns whether the hand holds something",
        _R,
        f"{SAMPLES}; {BRIDGES}",
        controllers=COBOTTA,
    ),
    CommandRow(
        "HandCurPos",
        "- BSTR",
        "R8",
        "returns the hand's width",
        _R,
        f"{SAMPLES}; {BRIDGES}",
        "",
        "width [mm]",
        controllers=COBOTTA,
    ),
    CommandRow(
        "HandCurPressure HandCurLoad",
        "- BSTR",
        "R8~",
        "returns the hand's pressure or load",
        _R,
        SAMPLES,
        controllers=COBOTTA,
    ),
    CommandRow(
        "run", "- BSTR V[]", "~", "runs a vision program (EVP2 provider)", _M, SAMPLES, controllers="EVP2"
    ),
    CommandRow(
        "MoveA", "V[] R8[]", "~", "moves an electric hand (ESC11 provider)", _M, SAMPLES, controllers="ESC11"
    ),
)
"""Commands of Controller_Execute."""

GRIPPER_COMMANDS: tuple[CommandRow, ...] = (
    CommandRow("HandGrip HandRelease", "- BSTR", "-~", "moves the hand", _M, NKAWA, controllers=COBOTTA_PRO),
    CommandRow(
        "TwofgGrip",
        "V[]",
        "-~",
        "moves the 2FG gripper",
        _M,
        NKAWA,
        "width [mm], force [N], speed [%], wait 0/1",
        controllers=COBOTTA_PRO,
    ),
    CommandRow(
        "TwofgRelease",
        "V[]",
        "-~",
        "moves the 2FG gripper",
        _M,
        NKAWA,
        "width [mm], wait 0/1",
        controllers=COBOTTA_PRO,
    ),
    CommandRow("TwofgStop", "- BSTR", "-~", "stops the 2FG gripper", _C, NKAWA, controllers=COBOTTA_PRO),
    CommandRow(
        "TwofgIsBusy",
        "- BSTR",
        "I4",
        "returns whether the 2FG gripper moves",
        _R,
        NKAWA,
        "",
        "0 or 1",
        controllers=COBOTTA_PRO,
    ),
    CommandRow(
        "TwofgIsConn TwofgIsGrip TwofgGetErrorCode TwofgGetMode",
        "- BSTR",
        "I4",
        "returns a state of the 2FG gripper",
        _R,
        NKAWA,
        controllers=COBOTTA_PRO,
    ),
    CommandRow(
        "TwofgGetWidth",
        "- BSTR",
        "R8",
        "returns the 2FG gripper's width",
        _R,
        NKAWA,
        "",
        "width [mm]",
        controllers=COBOTTA_PRO,
    ),
    CommandRow(
        "TwofgGetMinWidth TwofgGetMaxWidth TwofgGetForce",
        "- BSTR",
        "R8~",
        "returns a measure of the 2FG gripper",
        _R,
        NKAWA,
        controllers=COBOTTA_PRO,
    ),
)
"""Commands of Robot_Execute."""

EXTENSION_COMMANDS: tuple[CommandRow, ...] = (
    CommandRow("CurPos", "- BSTR", "R8~", "returns the hand's position", _R, SAMPLES, controllers="Hand0"),
    CommandRow("Chuck UnChuck", "I4 - BSTR", "-~", "moves the hand", _M, SAMPLES, controllers="Hand0"),
    CommandRow(
        "open close clear",
        "I4 - BSTR V[]",
        "-~",
        "handles a serial or socket line",
        _C,
        SAMPLES,
        "number of the line",
        controllers="Comm",
    ),
    CommandRow(
        "State count",
        "I4 - BSTR",
        "I4~",
        "describes a serial or socket line",
        _R,
        SAMPLES,
        "number of the line",
        controllers="Comm",
    ),
    CommandRow(
        "input",
        "I4 - BSTR V[]",
        "BSTR~",
        "reads from a serial or socket line",
        _C,
        SAMPLES,
        "number of the line",
        controllers="Comm",
    ),
    CommandRow(
        "CalcPos",
        "V[]",
        "R8[]~",
        "computes a place on a pallet",
        _R,
        SAMPLES,
        "rows, columns, height [mm], four corners, place, layer",
        "X, Y, Z [mm], Rx, Ry, Rz [deg], Fig",
        controllers="Pallet",
    ),
)
"""Commands of Extension_Execute; `controllers` names the extension."""
