"""Everything on the pages of b-CAP Tester in DENSO Wave 2009, key by key, against the simulator.

The bytes are those of its screens and of the function reference before them, but for serials and handles;
what is misread or missing in print is put right here: two letters of the command names, a byte of a reply.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Select

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.client.session import command_of
from bcapscope.player.player_messages import PlayOutcome, SlaveModePacing
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.simulator.kinematics import pad_joints, pose_of
from bcapscope.tui.controller_access.builtin_simulator import START_JOINTS
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.tester.call_lists import HistoryLines
from bcapscope.tui.tester.packet_pane import PacketBox
from tests.tui.pilot import drive, until
from tests.tui.tester import (
    COMMAND,
    RESULT,
    add_gundam,
    answered,
    connected,
    finish,
    go,
    make_tester,
    screen,
    sight,
    watched,
    write,
)

CHANGE_MODE = bytes.fromhex(
    "01 54 00 00 00 09 00 00 00 40 00 00 00 03 00 0A 00 00 00 03 00 01 00 00 00 01 00 00 00 24 00 00 00"
    "08 00 01 00 00 00 1A 00 00 00 73 00 6C 00 76 00 43 00 68 00 61 00 6E 00 67 00 65 00 4D 00 6F 00 64 00"
    "65 00"
    "0A 00 00 00 03 00 01 00 00 00 02 00 00 00 04"
)
CHANGE_MODE_I2 = bytes.fromhex(
    "01 52 00 00 00 05 00 00 00 40 00 00 00 03 00 0A 00 00 00 03 00 01 00 00 00 01 00 00 00 24 00 00 00"
    "08 00 01 00 00 00 1A 00 00 00 73 00 6C 00 76 00 43 00 68 00 61 00 6E 00 67 00 65 00 4D 00 6F 00 64 00"
    "65 00"
    "08 00 00 00 02 00 01 00 00 00 02 00 04"
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
MOVED_TO = "12.42261, 60.36072, 17.63196, 35.81433, 20.42798, 23.94792, 0.00000, 0.00000"
VARIABLE, VALUE = "#robot-variable .name", "#robot-variable ResultView"
GET_VALUE = 101
LIMIT = 280.0
"""Seconds for a test in which two players are started and play; a busy machine draws slowly."""


def without_serial_and_handle(raw: bytes) -> bytes:
    """Take out what differs from session to session; an RC7 repeats a retry's first serial in reserved."""
    return raw[:5] + raw[9:25] + raw[29:] if Frame(raw).code == 64 else raw[:5] + raw[9:]


async def change_mode(pilot: Pilot[None], vt: str, mode: int) -> None:
    await go(pilot, COMMAND, "shift+tab")
    await write(pilot, "slvChangeMode")
    await pilot.press("tab", "enter", "home", *["down"] * {"I2": 2, "I4": 3}[vt], "enter", "tab")
    await write(pilot, str(mode))
    await pilot.press("enter")
    here = screen(pilot)
    await until(pilot, lambda: here.session.status.slave_mode == mode)
    assert "(EMPTY)" in await answered(pilot, RESULT, "(EMPTY)")


async def move(pilot: Pilot[None]) -> None:
    await go(pilot, COMMAND, "shift+tab")
    await write(pilot, "slvMove")
    await go(pilot, "#execute TypedValue .value")
    await write(pilot, POINT)
    await pilot.press("enter")
    assert (await answered(pilot, RESULT, "12.4")).startswith(MOVED_TO)


async def read_position(pilot: Pilot[None]) -> None:
    """Add the variable that stands on the page, and get its value."""
    await go(pilot, VARIABLE)
    await write(pilot, "@CURRENT_POSITION")
    await pilot.press("enter")
    here = screen(pilot)
    await until(pilot, lambda: here.session.status.open_objects[-1].label == "@CURRENT_POSITION")
    await go(pilot, "#robot-variable .get")
    await pilot.press("enter")
    joints = pad_joints(tuple(map(float, POINT.split(", "))))
    shown_values = (await answered(pilot, VALUE, "63")).partition("  ")[0]
    assert [float(each) for each in shown_values.split(", ")] == pytest.approx(
        pose_of(PoseType.P, joints), abs=1e-4
    )
    handle = here.session.status.open_objects[-1].handle
    sent, _ = sent_and_received(pilot)
    assert sent == encode_frame(Frame(sent).serial, 0, GET_VALUE, [Variant(VT.I4, handle)])


def sent_and_received(pilot: Pilot[None]) -> tuple[bytes, bytes]:
    here = screen(pilot)
    sent, received = (here.query_one(f"#{name}", PacketBox).shown_packet for name in ("sent", "received"))
    assert sent is not None
    assert received is not None
    return sent.item.raw, received.item.raw


def hex_in_sight(pilot: Pilot[None], raw: bytes) -> bool:
    """Tell whether the first bytes stand on the screen as hex."""
    return raw[:8].hex(" ") in sight(pilot)


def control_log(folder: Path) -> Path:
    """Write a log as a controller does: a small swing of J6 from where the robot stands, and back."""
    path = folder / "log.csv"
    points = np.tile(np.array(START_JOINTS[:6]), (100, 1))
    points[:, 5] += 1.0 - np.cos(np.linspace(0, 2 * np.pi, 100))
    titles = ",".join(f"[J{axis} - 指令値]" for axis in range(1, 7))
    rows = "\n".join(",".join(f"{value:.6f}" for value in row) for row in points)
    path.write_bytes(f"{titles}\n{rows}\n".encode("cp932"))
    return path


async def play(pilot: Pilot[None], log: Path, pacing: SlaveModePacing) -> None:
    """Push Slave Mode, choose the log, push Start, and watch it to the end."""
    await go(pilot, "#slave-mode", "shift+tab")
    await pilot.press("enter")
    await until(pilot, lambda: isinstance(pilot.app.screen, SlaveScreen))
    here = pilot.app.screen
    assert isinstance(here, SlaveScreen)
    await until(pilot, lambda: isinstance(pilot.app.focused, Input))
    await write(pilot, str(log))
    await go(pilot, "#mode")
    await pilot.press("enter", "home", *["down"] * list(SlaveModePacing).index(pacing), "enter")
    assert here.query_one("#mode", Select).value is pacing
    start = here.query_one("#start")
    await until(pilot, lambda: not start.disabled)
    assert "fit to play: 100 set points" in sight(pilot)
    await go(pilot, "#start")
    await pilot.press("enter")
    await until(pilot, lambda: here.playback is not None and here.playback.plan.mode is pacing)
    ended = await watched(pilot, here)
    assert ended.outcome is PlayOutcome.DONE
    assert "played to the end" in sight(pilot)
    assert here.playback is not None
    asked = list(commands(Path(here.playback.plan.record or "")))
    mode = 0x002 if pacing is SlaveModePacing.SYNC else 0x102
    assert [value for name, value in asked if name == "slvchangemode"][-2:] == [mode, 0]
    assert sum(name == "slvmove" for name, _ in asked) >= 100
    await pilot.press("escape")
    await until(pilot, lambda: pilot.app.screen is screen(pilot))


def commands(record: Path) -> Iterator[tuple[str, object]]:
    """Yield the commands in a recording, retries left out, each with its parameter."""
    with open_capture(record) as capture:
        for seen in PacketDecoder().decode(capture):
            item = seen.item
            if isinstance(item, Frame) and item.code == 64 and item.reserved == 0:
                values = tuple(argument.variant for argument in item.arguments)
                yield command_of(item.code, values), values[2].value


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("size", "pacing"),
    [((80, 24), SlaveModePacing.SYNC), ((160, 48), SlaveModePacing.ASYNC)],
    ids=["80x24", "160x48"],
)
def test_the_pages(tmp_path: Path, size: tuple[int, int], pacing: SlaveModePacing) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await connected(pilot)
        await add_gundam(pilot)
        await pilot.press("ctrl+b")
        await until(pilot, lambda: "Task_Start" in _names(pilot))

        for vt, page in (("I2", CHANGE_MODE_I2), ("I4", CHANGE_MODE)):
            await change_mode(pilot, vt, 2)
            sent, received = sent_and_received(pilot)
            assert without_serial_and_handle(sent) == without_serial_and_handle(page)
            assert without_serial_and_handle(received) == without_serial_and_handle(CHANGED_MODE)
            await until(pilot, lambda sent=sent: hex_in_sight(pilot, sent))  # type: ignore[misc]  # bound now
            if vt == "I2":
                await change_mode(pilot, vt, 0)

        await move(pilot)
        sent, received = sent_and_received(pilot)
        assert without_serial_and_handle(sent) == without_serial_and_handle(MOVE)
        assert Frame(sent).reserved == 0
        assert without_serial_and_handle(received) == without_serial_and_handle(MOVED)
        await until(pilot, lambda: hex_in_sight(pilot, sent))

        await change_mode(pilot, "I4", 0)
        await read_position(pilot)
        await play(pilot, control_log(tmp_path), pacing)
        await finish(pilot)

    drive(make_tester(tmp_path), act, size, LIMIT)


def _names(pilot: Pilot[None]) -> list[str]:
    lines = screen(pilot).query_one(HistoryLines)
    return [function_name(record.function_id) for record in lines.items]
