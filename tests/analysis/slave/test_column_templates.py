"""Columns of many frames against each frame decoded on its own."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.slave.column_templates import (
    MAX_NUMBERS,
    MAX_TEMPLATES,
    ColumnReader,
    PickedNumbers,
    PoseColumns,
)
from bcapscope.analysis.slave.set_point_batch import FrameBytes
from bcapscope.protocol.codec.frame import Framing, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import pose_numbers
from bcapscope.protocol.slave_mode.slvmove_values import parse_feedback, parse_set_point

R8S, R4S = ARRAY | VT.R8, ARRAY | VT.R4
EXECUTE = 64
Pick = Callable[[Variant], PickedNumbers]


def pick_command(parameter: Variant) -> PickedNumbers:
    pose = parse_set_point(parameter, PoseType.J).pose
    return (pose.values if pose else ()), None


def pick_result(result: Variant) -> PickedNumbers:
    feedback = parse_feedback(result, PoseType.J)
    return (feedback.poses[0].values if feedback.poses else ()), feedback.timestamp


def i4(value: int) -> Variant:
    return Variant(VT.I4, value)


def mixed(*parts: Variant) -> Variant:
    return Variant.array(VT.VARIANT, parts)


doubles = st.tuples(*[st.floats(-360, 360)] * 8).map(lambda row: Variant.array(VT.R8, row))
singles = st.tuples(*[st.floats(-360, 360, width=32)] * 8).map(lambda row: Variant.array(VT.R4, row))
words = st.integers(-(2**31), 2**31 - 1).map(i4)
listed = st.tuples(*[st.integers(-180, 180).map(i4) | st.floats(-9, 9).map(lambda x: Variant(VT.R8, x))] * 8)
parameters = st.one_of(
    doubles,
    singles,
    st.tuples(doubles, words).map(lambda parts: mixed(*parts)),
    listed.map(lambda parts: mixed(*parts)),
    st.just(EMPTY),
    st.just(Variant(VT.BSTR, "nowhere")),
)
data = st.binary(max_size=4).map(lambda raw: Variant(ARRAY | VT.UI1, raw, len(raw)))
results = st.one_of(
    doubles,
    st.tuples(words, doubles).map(lambda parts: mixed(*parts)),
    st.tuples(words, doubles, data, words).map(lambda parts: mixed(*parts)),
    st.tuples(words, doubles, data).map(lambda parts: mixed(*parts)),
    st.just(EMPTY),
)


def expected(pick: Pick, raws: list[bytes], variants: list[Variant], axes: int) -> PoseColumns:
    columns = PoseColumns(len(raws), axes)
    for row, (raw, variant) in enumerate(zip(raws, variants, strict=True)):
        pose, stamp = pick(variant) if raw else ((), None)
        if len(pose) >= axes:
            columns.poses[row], columns.has_pose[row] = pose[:axes], True
        if stamp is not None:
            columns.stamps[row] = stamp
    return columns


def assert_equal(found: PoseColumns, wanted: PoseColumns) -> None:
    np.testing.assert_array_equal(found.poses, wanted.poses)
    np.testing.assert_array_equal(found.has_pose, wanted.has_pose)
    np.testing.assert_array_equal(found.stamps, wanted.stamps)


@settings(deadline=None)
@given(st.lists(parameters, max_size=30), st.integers(1, 8), st.integers(0, 30))
def test_set_points_are_read_as_one_by_one(variants: list[Variant], axes: int, cut: int) -> None:
    raws = [
        encode_frame(n, n % 3, EXECUTE, (i4(2), Variant(VT.BSTR, "slvMove"), variant))
        for n, variant in enumerate(variants)
    ]
    forms = ColumnReader(2, pick_command)
    for part in (slice(cut), slice(cut, None)):
        assert_equal(
            forms.read(FrameBytes(raws[part]), len(raws[part]), axes),
            expected(pick_command, raws[part], variants[part], axes),
        )


@settings(deadline=None)
@given(st.lists(st.tuples(results, st.booleans()), max_size=30))
def test_results_are_read_as_one_by_one(replies: list[tuple[Variant, bool]]) -> None:
    variants = [variant for variant, _ in replies]
    raws = [encode_frame(n, 0, 0, (variant,)) if there else b"" for n, (variant, there) in enumerate(replies)]
    assert_equal(read(0, pick_result, raws), expected(pick_result, raws, variants, 8))


def read(argument: int, pick: Pick, raws: list[bytes]) -> PoseColumns:
    return ColumnReader(argument, pick).read(FrameBytes(raws), len(raws), 8)


def test_a_handle_belongs_to_the_form() -> None:
    pose = Variant.array(VT.R8, tuple(map(float, range(8))))
    raws = [encode_frame(n, 0, EXECUTE, (i4(n % 2), Variant(VT.BSTR, "slvMove"), pose)) for n in range(6)]
    assert read(2, pick_command, raws).has_pose.all()


def test_more_forms_than_are_kept() -> None:
    pose = Variant.array(VT.R8, tuple(map(float, range(8))))
    raws = [
        encode_frame(n, 0, EXECUTE, (i4(n), Variant(VT.BSTR, "slvMove"), pose))
        for n in range(MAX_TEMPLATES * 3)
    ]
    columns = read(2, pick_command, raws)
    assert columns.has_pose.all()
    assert (columns.poses == np.arange(8)).all()


@pytest.mark.parametrize("framing", [Framing.VERSION_1, Framing.VERSION_1_ZLIB, Framing.SERIAL_LINE])
def test_other_framings_are_read_on_their_own(framing: Framing) -> None:
    pose = Variant.array(VT.R8, tuple(map(float, range(8))))
    reserved = 0 if framing is Framing.SERIAL_LINE else 1
    raws = [encode_frame(n, reserved, EXECUTE, (i4(1), EMPTY, pose), framing) for n in range(3)]
    columns = read(2, pick_command, raws)
    assert (columns.poses == np.arange(8)).all()


def test_very_many_numbers() -> None:
    row = tuple(map(float, range(MAX_NUMBERS + 1)))
    raw = encode_frame(1, 0, EXECUTE, (i4(1), EMPTY, Variant.array(VT.R8, row)))
    columns = read(2, lambda variant: (pose_numbers(variant) or (), None), [raw, raw])
    assert (columns.poses == np.arange(8)).all()


@given(st.lists(st.binary(max_size=40).map(lambda tail: struct.pack("<BIHHIH", 1, 99, 0, 0, 64, 3) + tail)))
def test_no_bytes_break_it(raws: list[bytes]) -> None:
    columns = read(2, pick_command, raws)
    assert len(columns.poses) == len(raws)


@given(st.integers(0, 200), st.integers(0, 255))
def test_a_damaged_frame_among_sound_ones(position: int, byte: int) -> None:
    pose = Variant.array(VT.R8, tuple(map(float, range(8))))
    sound = encode_frame(1, 0, EXECUTE, (i4(1), Variant(VT.BSTR, "slvMove"), pose))
    damaged = bytearray(sound)
    damaged[position % len(sound)] = byte
    columns = read(2, pick_command, [sound, bytes(damaged), sound])
    assert (columns.poses[[0, 2]] == np.arange(8)).all()
