"""Bits of slvSendFormat and slvRecvFormat."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.slave_mode.formats import (
    FormatParameter,
    ReceiveFormat,
    SendFormat,
    parse_format_parameter,
)
from bcapscope.protocol.slave_mode.modes import PoseType

ANY_I4 = st.integers(-(2**31), 2**31 - 1)
P, J, T = PoseType.P, PoseType.J, PoseType.T


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0x000, SendFormat()),
        (0x020, SendFormat(hand_io=True)),
        (0x100, SendFormat(mini_io=True)),
        (0x120, SendFormat(hand_io=True, mini_io=True)),
        (0x220, SendFormat(hand_io=True, user_io=True)),
        (0x001, SendFormat(other=1)),
    ],
)
def test_send_format(value: int, expected: SendFormat) -> None:
    assert SendFormat.parse(value) == expected
    assert int(expected) == value


def test_send_formats_that_clients_use() -> None:
    known = [value for value in range(0x1000) if SendFormat.parse(value).is_known]
    plain = [0, 0x020, 0x100, 0x120, 0x200, 0x220]
    assert known == plain + [0x400 | value for value in plain]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0x001, ReceiveFormat(poses=(P,))),
        (0x014, ReceiveFormat(poses=(P, J), timestamp=True)),
        (0x005, ReceiveFormat(poses=(T, J))),
        (0x172, ReceiveFormat(poses=(J,), timestamp=True, hand_io=True, current=True, mini_io=True)),
        (0x202, ReceiveFormat(poses=(J,), user_io=True)),
        (0x006, ReceiveFormat(other=6)),
        (0x802, ReceiveFormat(poses=(J,), other=0x800)),
    ],
)
def test_receive_format(value: int, expected: ReceiveFormat) -> None:
    assert ReceiveFormat.parse(value) == expected
    assert int(expected) == value


@pytest.mark.parametrize(
    ("value", "known"),
    [(0x002, True), (0x172, True), (0x342, True), (0x302, False), (0x007, False), (0x402, False)],
)
def test_receive_formats_that_the_driver_knows(value: int, known: bool) -> None:
    assert ReceiveFormat.parse(value).is_known is known


@given(ANY_I4)
def test_any_number_round_trips(value: int) -> None:
    assert int(SendFormat.parse(value)) == value
    assert int(ReceiveFormat.parse(value)) == value


@pytest.mark.parametrize(
    ("parameter", "expected"),
    [
        (Variant(VT.I4, 0x14), FormatParameter(0x14)),
        (Variant.array(VT.I4, (0x14, 1)), FormatParameter(0x14, True)),
        (Variant.array(VT.I4, (0x14, 0)), FormatParameter(0x14, False)),
        (Variant.array(VT.VARIANT, (Variant(VT.I2, 2), Variant(VT.I4, 1))), FormatParameter(2, True)),
        (
            Variant.array(VT.VARIANT, (Variant(VT.I2, 2), Variant(VT.I4, 1), Variant(VT.BSTR, "?"))),
            FormatParameter(2, True),
        ),
        (Variant.array(VT.I4, ()), None),
        (Variant.array(VT.UI1, b"\x14"), None),
        (Variant(VT.BOOL, True), None),
        (Variant(VT.R8, 2.0), None),
        (EMPTY, None),
    ],
)
def test_parameters(parameter: Variant, expected: FormatParameter | None) -> None:
    assert parse_format_parameter(parameter) == expected


def test_poses_that_no_format_returns() -> None:
    with pytest.raises(ValueError, match="slvRecvFormat cannot"):
        ReceiveFormat(poses=(J, P))


@pytest.mark.parametrize(
    ("value", "bare"), [(0x001, P), (0x003, T), (0x012, None), (0x004, None), (0x000, None)]
)
def test_formats_that_return_a_pose_as_it_is(value: int, bare: PoseType | None) -> None:
    assert ReceiveFormat.parse(value).bare_pose_type is bare
