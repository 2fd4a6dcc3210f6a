"""Titles of columns: what they say, and that those that are not understood say nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.player.titles import COUNTER, NUMBER, TIME, UNITS, Role, Title, read_title
from bcapscope.protocol.poses import AXES

NAMES = {axis.name for kind in AXES.values() for axis in kind} | {TIME, COUNTER, NUMBER}


@pytest.mark.parametrize(
    ("text", "axis", "role", "unit"),
    [
        ("[J1 - 指令値]", "J1", Role.COMMANDED, None),
        ("[J8 - エンコーダ値]", "J8", Role.MEASURED, None),
        ("[FIG - 指令値]", "Fig", Role.COMMANDED, None),
        ("[RX - 指令値]", "Rx", Role.COMMANDED, None),
        ("[Rz]", "Rz", Role.UNMARKED, None),
        ("Ｊ３－指令値", "J3", Role.COMMANDED, None),
        ("J2指令値[deg]", "J2", Role.COMMANDED, "deg"),
        ("[J1 - Command]", "J1", Role.COMMANDED, None),
        ("Joint 3 command value", "J3", Role.COMMANDED, None),
        ("joint_4", "J4", Role.UNMARKED, None),
        ("J1 (rad)", "J1", Role.UNMARKED, "rad"),
        ("target x_m", "X", Role.COMMANDED, "m"),
        ("returned_J1_deg", "J1", Role.MEASURED, "deg"),
        ("J6 actual", "J6", Role.MEASURED, None),
        ("time_s", TIME, Role.UNMARKED, "s"),
        ("Time [ms]", TIME, Role.UNMARKED, "ms"),
        ("t", TIME, Role.UNMARKED, None),
        ("[コントローラ起動時からのカウンタ]", COUNTER, Role.UNMARKED, None),
        ("[Counter since the controller started]", COUNTER, Role.UNMARKED, None),
        ("[No.]", NUMBER, Role.UNMARKED, None),
    ],
)
def test_what_a_title_says(text: str, axis: str, role: Role, unit: str | None) -> None:
    assert read_title(text) == Title(axis, role, UNITS[unit] if unit else None)


@pytest.mark.parametrize(
    "text",
    [
        "[J1 - 電流値]",
        "[J1 - 負荷率]",
        "[J1 - Motor current]",
        "[X - 力覚センサー値]",
        "[移動量X - 指令値]",
        "[移動量RX - エンコーダ値]",
        "[力制御機能有効]",
        "[ユーザデータ]",
        "[行番号]",
        "controller_time_ms",
        "reply_s",
        "call",
        "J9",
        "J1 J2",
        "J12",
        "velocity J1",
        "",
        "指令値",
    ],
)
def test_what_says_nothing(text: str) -> None:
    assert read_title(text) is None


@given(st.text(max_size=200))
def test_any_text_says_something_known_or_nothing(text: str) -> None:
    title = read_title(text)
    assert title is None or title.axis in NAMES
