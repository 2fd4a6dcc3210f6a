"""Everything on the pages of b-CAP Tester in DENSO Wave 2009, key by key, against the simulator.

The bytes are those of its screens, but for serials and handles; two letters of the command names are misread
on the page and put right here.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot

from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import function_name
from bcapscope.tui.tester.history import HistoryLines
from bcapscope.tui.tester.packetbox import PacketBox
from tests.tui.pilot import drive, until
from tests.tui.tester import answered, connected, finish, go, make_tester, screen, write

CHANGE_MODE = bytes.fromhex(
    "01 54 00 00 00 09 00 00 00 40 00 00 00 03 00 0A 00 00 00 03 00 01 00 00 00 01 00 00 00 24 00 00 00"
    "08 00 01 00 00 00 1A 00 00 00 73 00 6C 00 76 00 43 00 68 00 61 00 6E 00 67 00 65 00 4D 00 6F 00 64 00"
    "65 00"
    "0A 00 00 00 03 00 01 00 00 00 02 00 00 00 04"
)
CHANGED_MODE = bytes.fromhex("01 10 00 00 00 09 00 00 00 00 00 00 00 00 00 04")
MOVE = bytes.fromhex(
    "01 5C 00 00 00 0A 00 00 00 40 00 00 00 03 00 0A 00 00 00 03 00 01 00 00 00 01 00 00 00 18 00 00 00"
    "08 00 01 00 00 00 0E 00 00 00 73 00 6C 00 76 00 4D 00 6F 00 76 00 65 00 1E 00 00 00 04 20 06 00 00 00"
    "03 C3 46 41 BF 71 71 42 FE 0E 8D 41 E0 41 0F 42 81 6C A3 41 1F 97 BF 41 04"
)
MOVED = bytes.fromhex(
    "01 3A 00 00 00 0A 00 00 00 00 00 00 00 01 00 26 00 00 00 04 20 08 00 00 00"
    "00 C3 46 41 60 71 71 42 40 0E 8D 41 E0 41 0F 42 80 6C A3 41 56 95 BF 41 00 00 00 00 00 00 00 00 04"
)
POINT = "12.42261, 60.36108, 17.63232, 35.81433, 20.42798, 23.94879"
COMMAND = "#robot-forms .command"
RESULT = "#execute ResultView"


def without_serial_and_handle(raw: bytes) -> bytes:
    """Take out what differs from session to session; an RC7 repeats a retry's first serial in reserved."""
    return raw[:5] + raw[9:25] + raw[29:] if Frame(raw).code == 64 else raw[:5] + raw[9:]


async def add_gundam(pilot: Pilot[None]) -> None:
    await go(pilot, "#add-robot .name", "shift+tab")
    await write(pilot, "Gundam")
    await pilot.press("enter")
    here = screen(pilot)
    await until(pilot, lambda: here.desk.status.robot and here.desk.status.robot.label == "Gundam")


async def change_mode(pilot: Pilot[None], vt: str) -> None:
    await go(pilot, COMMAND)
    await write(pilot, "slvChangeMode")
    await pilot.press("tab", "enter", "home", *["down"] * {"I2": 2, "I4": 3}[vt], "enter", "tab")
    await write(pilot, "2")
    await pilot.press("enter")
    assert "(EMPTY)" in await answered(pilot, RESULT, "(EMPTY)")


async def move(pilot: Pilot[None]) -> None:
    await go(pilot, COMMAND, "shift+tab")
    await write(pilot, "slvMove")
    await go(pilot, "#execute TypedValue .value")
    await write(pilot, POINT)
    await pilot.press("enter")
    shown_result = await answered(pilot, RESULT, "12.4")
    assert shown_result.startswith(
        "12.42261, 60.36072, 17.63196, 35.81433, 20.42798, 23.94792, 0.00000, 0.00000"
    )


def sent_and_received(pilot: Pilot[None]) -> tuple[bytes, bytes]:
    here = screen(pilot)
    sent, received = (here.query_one(f"#{name}", PacketBox).shown for name in ("sent", "received"))
    assert sent is not None
    assert received is not None
    return sent.item.raw, received.item.raw


@pytest.mark.parametrize("size", [(80, 24), (160, 48)], ids=["80x24", "160x48"])
def test_the_pages(tmp_path: Path, size: tuple[int, int]) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await connected(pilot)
        await add_gundam(pilot)
        await pilot.press("ctrl+b")
        await until(pilot, lambda: "Task_Start" in _names(pilot))

        await change_mode(pilot, "I4")
        sent, received = sent_and_received(pilot)
        assert without_serial_and_handle(sent) == without_serial_and_handle(CHANGE_MODE)
        assert without_serial_and_handle(received) == without_serial_and_handle(CHANGED_MODE)

        await move(pilot)
        sent, received = sent_and_received(pilot)
        assert without_serial_and_handle(sent) == without_serial_and_handle(MOVE)
        assert Frame(sent).reserved == 0
        assert without_serial_and_handle(received) == without_serial_and_handle(MOVED)
        await pilot.press("f12")
        await finish(pilot)

    drive(make_tester(tmp_path), act, size)


def _names(pilot: Pilot[None]) -> list[str]:
    lines = screen(pilot).query_one(HistoryLines)
    return [function_name(record.function_id) for record in lines._shown]
