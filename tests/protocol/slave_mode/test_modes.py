"""Slave modes against the slides of 2009 and the table in DENSO's samples."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import VT, Variant, integer_value
from bcapscope.protocol.slave_mode.modes import (
    MODES,
    PERIOD_MS,
    PERIOD_NS,
    Generation,
    ModeKind,
    PoseType,
    SlaveMode,
    pose_type_of_mode,
    slave_mode_by_number,
)

RC7, RC8 = Generation.RC7, Generation.RC8


def test_a_controller_takes_a_set_point_every_8_ms() -> None:
    assert (PERIOD_MS, PERIOD_NS) == (8, 8_000_000)


@pytest.mark.parametrize(
    ("value", "generation", "pose_type", "kind", "slots", "paces", "underflow_is_error"),
    [
        (0x001, RC7, PoseType.P, ModeKind.SYNC, 1, True, True),
        (0x002, RC7, PoseType.J, ModeKind.SYNC, 1, True, True),
        (0x103, RC7, PoseType.T, ModeKind.ASYNC, 1, False, None),
        (0x001, RC8, PoseType.P, ModeKind.MODE_0, 3, False, True),
        (0x102, RC8, PoseType.J, ModeKind.MODE_1, 1, False, False),
        (0x202, RC8, PoseType.J, ModeKind.MODE_2, 3, True, True),
        (0x000, RC8, None, ModeKind.OFF, 0, False, False),
        (0x000, RC7, None, ModeKind.OFF, 0, False, False),
    ],
)
def test_modes(
    *,
    value: int,
    generation: Generation,
    pose_type: PoseType | None,
    kind: ModeKind,
    slots: int,
    paces: bool,
    underflow_is_error: bool | None,
) -> None:
    mode = slave_mode_by_number(value, generation)
    assert mode is not None
    assert (mode.pose_type, mode.kind, mode.buffer_slots) == (pose_type, kind, slots)
    assert (mode.paces_client, mode.underflow_is_error) == (paces, underflow_is_error)


@pytest.mark.parametrize(
    ("value", "generation"),
    [(0x201, RC7), (0x004, RC8), (0x100, RC8), (0x200, RC8), (0x302, RC8), (-1, RC8), (0x1002, RC7)],
)
def test_numbers_that_are_no_mode(value: int, generation: Generation) -> None:
    assert slave_mode_by_number(value, generation) is None


def test_counts() -> None:
    assert sum(mode.generation is RC7 for mode in MODES) == 7
    assert sum(mode.generation is RC8 for mode in MODES) == 10


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: f"{mode.generation}-{mode.value:03X}")
def test_every_mode_round_trips(mode: SlaveMode) -> None:
    assert slave_mode_by_number(int(mode), mode.generation) is mode
    assert integer_value(Variant(VT.I2, int(mode))) == mode.value
    assert pose_type_of_mode(mode.value) is mode.pose_type
    assert mode.text


def test_only_mode_0_overflows() -> None:
    assert {mode.kind for mode in MODES if mode.overflow_is_error} == {ModeKind.MODE_0}


def test_a_new_set_point_replaces_the_waiting_one_where_replies_come_at_once_and_nothing_overflows() -> None:
    for mode in MODES:
        answers_at_once = mode.kind is not ModeKind.OFF and not mode.paces_client
        assert mode.overwrites_waiting is (answers_at_once and not mode.overflow_is_error)


@given(st.integers(-(2**31), 2**31 - 1), st.sampled_from(Generation))
def test_any_number_is_a_mode_or_none(value: int, generation: Generation) -> None:
    mode = slave_mode_by_number(value, generation)
    assert mode is None or (mode.value, mode.generation) == (value, generation)
    if mode is not None:
        assert pose_type_of_mode(value) is mode.pose_type
