"""The catalogue of commands holds every command that public clients and documents name."""

from __future__ import annotations

import re

import pytest

from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import commands_of, find_command
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.table_rows import table_rows
from tests.shared_folder import SHARED

CONTROLLER_EXECUTE, EXTENSION_EXECUTE = ID["Controller_Execute"], ID["Extension_Execute"]
ROBOT_EXECUTE, TASK_EXECUTE = ID["Robot_Execute"], ID["Task_Execute"]

FACTS = SHARED / "PROTOCOL.md"

CALLED_BY_CLIENTS = {
    CONTROLLER_EXECUTE: (
        "HandMoveA HandMoveR HandMoveH HandMoveAH HandMoveRH HandStop HandHoldState HandCurPos ClearError "
        "GetCurErrorInfo GetCurErrorCount ManualResetPreparation"
    ),
    EXTENSION_EXECUTE: "CurPos Chuck UnChuck open State clear count input close CalcPos",
    ROBOT_EXECUTE: (
        "Dev DevH CheckVirtualFence DriveEx DriveAEx SyncTimeStart SyncTimeEnd SyncMoveStart SyncMoveEnd "
        "ForceParam AutoCal Motor ExtSpeed ManualResetPreparation slvChangeMode slvMove slvSendFormat "
        "slvRecvFormat TakeArm GiveArm"
    ),
    TASK_EXECUTE: "GetStatus",
}
"""What programs of users were seen to call, by the function that carries it."""


def test_every_row_names_its_sources() -> None:
    rows = list(table_rows("commands"))
    assert len(rows) > 90
    assert all(row["text"] and row["sources"] for row in rows)


@pytest.mark.parametrize(
    ("function_id", "name"),
    [(function_id, name) for function_id, names in CALLED_BY_CLIENTS.items() for name in names.split()],
)
def test_what_clients_call_is_there(function_id: int, name: str) -> None:
    assert find_command(function_id, name) is not None


def _named(section: str) -> list[str]:
    """Return the commands of one table, which stand in its second column."""
    cells = re.findall(r"^\| \d+ \| ([^|]*) \|", section, re.MULTILINE)
    names = [word for cell in cells for word in re.split(r"[/,]", re.sub(r"\(.*?\)|…", "", cell))]
    return [name.strip() for name in names if name.strip()]


@pytest.mark.interop
def test_every_command_of_the_facts_is_there() -> None:
    if not FACTS.exists():
        pytest.skip(f"{FACTS} is not here")
    text = FACTS.read_text(encoding="utf-8")
    robot, controller = (
        _named(text[text.index(f"### {start} ") : text.index(f"### {end} ")])
        for start, end in (("7.1", "7.2"), ("7.2", "7.3"))
    )
    assert len(robot) > 70
    assert len(controller) > 15
    assert [name for name in robot if find_command(ROBOT_EXECUTE, name) is None] == []
    assert [name for name in controller if find_command(CONTROLLER_EXECUTE, name) is None] == []
    called = text[text.index("## Appendix C2") : text.index("## Appendix D")]
    catalogue = {each.name for owner in CALLED_BY_CLIENTS for each in commands_of(owner)}
    words = set(re.findall(r"\b(?:Hand[A-Z]|Sync|Force[A-Z]|Dev|Check|Auto|Manual)\w*", called))
    assert len(words) > 10
    assert {word for word in words if word not in catalogue} <= {"Hand0"}


@pytest.mark.parametrize(
    ("function_id", "names", "effect"),
    [
        (
            CONTROLLER_EXECUTE,
            "HandMoveA HandMoveR HandMoveH HandMoveAH HandMoveRH HandMoveVH",
            CallEffect.MOVES,
        ),
        (CONTROLLER_EXECUTE, "HandChuck HandUnChuck", CallEffect.MOVES),
        (CONTROLLER_EXECUTE, "HandStop", CallEffect.CHANGES),
        (CONTROLLER_EXECUTE, "HandHoldState HandCurPos HandCurPressure HandCurLoad", CallEffect.READS),
        (ROBOT_EXECUTE, "SyncTimeStart SyncTimeEnd SyncMoveStart SyncMoveEnd AutoCal", CallEffect.MOVES),
        (ROBOT_EXECUTE, "HandGrip HandRelease TwofgGrip TwofgRelease", CallEffect.MOVES),
        (ROBOT_EXECUTE, "Dev DevH CheckVirtualFence TwofgIsBusy TwofgGetWidth TwofgIsGrip", CallEffect.READS),
        (EXTENSION_EXECUTE, "Chuck UnChuck", CallEffect.MOVES),
    ],
)
def test_what_moves_is_told_from_what_reads(function_id: int, names: str, effect: CallEffect) -> None:
    for name in names.split():
        found = find_command(function_id, name)
        assert found is not None
        assert found.effect is effect
