"""The guard: what it refuses, and what nobody holds up."""

from __future__ import annotations

import pytest

from bcapscope.protocol.commands import commands
from bcapscope.protocol.effects import Effect
from bcapscope.protocol.frame import Frame, encode
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.variant import VT, Variant
from bcapscope.proxy.guard import Guard, Target, read_target
from bcapscope.traffic.question import COMMAND_FUNCTIONS

EXECUTE = 64


def asked(function_id: int, command: str | None = None, *more: Variant) -> Frame:
    """Make a request."""
    arguments = [Variant(VT.I4, 1)]
    if command is not None:
        arguments.append(Variant(VT.BSTR, command))
    return Frame(encode(5, 0, function_id, [*arguments, *more]))


NAMES = {function.name: function.id for function in FUNCTIONS.values()}
ZERO = Variant(VT.I4, 0)
MODE = Variant(VT.I4, 0x101)


@pytest.mark.parametrize(
    "frame",
    [
        asked(NAMES["Robot_Halt"]),
        asked(EXECUTE, "slvChangeMode", ZERO),
        asked(EXECUTE, "SLVCHANGEMODE", Variant(VT.I2, 0)),
        asked(NAMES["Robot_Release"]),
        asked(NAMES["Controller_Disconnect"]),
        asked(NAMES["Service_Stop"]),
        asked(NAMES["Service_Start"]),
        asked(NAMES["Variable_GetValue"]),
        asked(EXECUTE, "CurJnt"),
    ],
    ids=lambda frame: f"{frame.code} {frame.argc}",
)
def test_reading_and_stopping_pass(frame: Frame) -> None:
    assert Guard(read_only=True).refuses(frame) == ""


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (asked(EXECUTE, "slvMove", Variant.array(VT.R4, (1.0,))), "read-only: Robot_Execute 'slvMove'"),
        (asked(EXECUTE, "slvChangeMode", MODE), "read-only: Robot_Execute 'slvChangeMode'"),
        (asked(NAMES["Robot_Move"]), "read-only: Robot_Move"),
        (asked(NAMES["Variable_PutValue"]), "read-only: Variable_PutValue"),
        (asked(EXECUTE, "NobodyKnowsThis"), "read-only: Robot_Execute 'NobodyKnowsThis'"),
        (asked(200), "read-only: Unknown(200)"),
        (asked(EXECUTE), "read-only: Robot_Execute"),
        (Frame(asked(NAMES["Variable_GetValue"]).raw[:-1]), "read-only: a damaged Variable_GetValue"),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_what_moves_or_changes_or_is_not_known_is_refused(frame: Frame, reason: str) -> None:
    assert Guard(read_only=True).refuses(frame) == reason


def test_every_command_of_the_catalogue_goes_by_its_effect() -> None:
    guard = Guard(read_only=True)
    for function_id in COMMAND_FUNCTIONS:
        for command in commands(function_id):
            refused = bool(guard.refuses(asked(function_id, command.name, MODE)))
            assert refused == (command.effect > Effect.SESSION), command.name


def test_lists_block_and_allow() -> None:
    guard = Guard(block=[read_target("slvmove"), read_target("Robot_Move")])
    assert guard.refuses(asked(EXECUTE, "slvMove")) == "Robot_Execute 'slvMove' is blocked"
    assert guard.refuses(asked(NAMES["Robot_Move"])) == "Robot_Move is blocked"
    assert guard.refuses(asked(NAMES["Variable_PutValue"])) == ""
    guard = Guard(
        True, block=[read_target("slvMove")], allow=[read_target("Robot_Execute"), read_target("Robot_Move")]
    )
    assert guard.refuses(asked(EXECUTE, "slvMove"))
    assert guard.refuses(asked(EXECUTE, "TakeArm")) == ""
    assert guard.refuses(asked(NAMES["Robot_Move"])) == ""
    assert guard.refuses(asked(NAMES["Robot_Drive"]))


def test_nobody_blocks_what_stops_the_robot() -> None:
    guard = Guard(block=[read_target("Robot_Halt"), read_target("slvChangeMode")])
    assert guard.refuses(asked(NAMES["Robot_Halt"])) == ""
    assert guard.refuses(asked(EXECUTE, "slvChangeMode", ZERO)) == ""
    assert guard.refuses(asked(EXECUTE, "slvChangeMode", MODE))


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("Robot_Move", Target(72, None)),
        ("robot_move", Target(72, None)),
        ("SlvMove", Target(None, "slvmove")),
        ("Robot_Execute:MyOwn", Target(64, "myown")),
    ],
)
def test_targets_are_read(text: str, target: Target) -> None:
    assert read_target(text) == target


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("slvMve", "did you mean 'slvMove'.*Robot_Execute:slvMve"),
        ("Robot_Mov", "did you mean 'Robot_Move'"),
        ("Robot_Move:x", "'Robot_Move' takes no commands"),
        ("x:y", "'x' takes no commands"),
    ],
)
def test_misspelt_targets_are_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_target(text)
