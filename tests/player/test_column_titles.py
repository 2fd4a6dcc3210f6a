"""Titles of columns: what they say, and that those that are not understood say nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.player.column_layout import COUNTER, NUMBER, TIME, UNITS, ColumnRole, ColumnTitle, read_title
from bcapscope.protocol.slave_mode.poses import AXES

NAMES = {axis.name for kind in AXES.values() for axis in kind} | {TIME, COUNTER, NUMBER}


@pytest.mark.parametrize(
    ("text", "axis", "role", "unit"),
    [
        ("[J1 - 指令値]", "J1", ColumnRole.COMMANDED, None),
        ("[J8 - エンコーダ値]", "J8", ColumnRole.MEASURED, None),
        ("[FIG - 指令値]", "Fig", ColumnRole.COMMANDED, None),
        ("[RX - 指令値]", "Rx", ColumnRole.COMMANDED, None),
        ("[Rz]", "Rz", ColumnRole.UNMARKED, None),
        ("Ｊ３－指令値", "J3", ColumnRole.COMMANDED, None),
        ("J2指令値[deg]", "J2", ColumnRole.COMMANDED, "deg"),
        ("[J1 - Command]", "J1", ColumnRole.COMMANDED, None),
        ("Joint 3 command value", "J3", ColumnRole.COMMANDED, None),
        ("joint_4", "J4", ColumnRole.UNMARKED, None),
        ("J1 (rad)", "J1", ColumnRole.UNMARKED, "rad"),
        ("target x_m", "X", ColumnRole.COMMANDED, "m"),
        ("returned_J1_deg", "J1", ColumnRole.MEASURED, "deg"),
        ("J6 actual", "J6", ColumnRole.MEASURED, None),
        ("time_s", TIME, ColumnRole.UNMARKED, "s"),
        ("Time [ms]", TIME, ColumnRole.UNMARKED, "ms"),
        ("t", TIME, ColumnRole.UNMARKED, None),
        ("[コントローラ起動時からのカウンタ]", COUNTER, ColumnRole.UNMARKED, None),
        ("[Counter since the controller started]", COUNTER, ColumnRole.UNMARKED, None),
        ("[No.]", NUMBER, ColumnRole.UNMARKED, None),
    ],
)
def test_what_a_title_says(text: str, axis: str, role: ColumnRole, unit: str | None) -> None:
    assert read_title(text) == ColumnTitle(axis, role, UNITS[unit] if unit else None)


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
