"""Single frames as bytes and as objects."""

from __future__ import annotations

import pytest

import bcapscope
from bcapscope import VT, Variant


def test_a_request_by_the_name_of_its_function() -> None:
    raw = bcapscope.encode("Robot_Execute", [2, "CurJnt", None], serial=7, reserved=5)
    frame = bcapscope.decode(raw)
    assert (frame.serial, frame.reserved, frame.code, frame.problems) == (7, 5, 64, ())
    assert frame.variants == (Variant(VT.I4, 2), Variant(VT.BSTR, "CurJnt"), Variant(VT.EMPTY, None))


def test_arguments_get_the_types_of_the_function() -> None:
    frame = bcapscope.decode(bcapscope.encode("Robot_Speed", [2, -1, 50]))
    assert [variant.vt for variant in frame.variants] == [VT.I4, VT.I4, VT.R4]


@pytest.mark.parametrize(
    ("code", "number"), [("S_OK", 0), ("E_HANDLE", 0x80070006), (-1, 0xFFFFFFFF), (64, 64), (200, 200)]
)
def test_a_frame_by_a_result_or_a_number(code: str | int, number: int) -> None:
    frame = bcapscope.decode(bcapscope.encode(code, [[1.0, 2.0]]))
    assert frame.code == number
    assert frame.variants == (Variant.array(VT.R8, (1.0, 2.0)),)


def test_an_unknown_name_is_an_input_error_with_the_nearest_name() -> None:
    with pytest.raises(bcapscope.InputError, match=r"'Robot_Exekute', did you mean 'Robot_Execute'\?"):
        bcapscope.encode("Robot_Exekute")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([2, "CurJnt"], "Robot_Execute takes 3 arguments, not 2"),
        (["2", "CurJnt", None], "Robot_Execute, hRobot: '2' is not a VT_I4"),
        ([2, "CurJnt", {}], "b-CAP has no type for a dict"),
    ],
)
def test_bad_arguments_are_a_local_protocol_error(arguments: list[object], sentence: str) -> None:
    with pytest.raises(bcapscope.LocalProtocolError, match=sentence):
        bcapscope.encode("Robot_Execute", arguments)


@pytest.mark.parametrize("serial", [-1, 65536])
def test_a_serial_that_does_not_fit_is_a_local_protocol_error(serial: int) -> None:
    with pytest.raises(bcapscope.LocalProtocolError):
        bcapscope.encode("S_OK", serial=serial)


def test_damage_is_listed_and_raises_nothing() -> None:
    raw = bcapscope.encode("Robot_Execute", [2, "CurJnt", None])
    frame = bcapscope.decode(memoryview(raw)[:-4])
    assert frame.problems
    assert frame.variants[:2] == (Variant(VT.I4, 2), Variant(VT.BSTR, "CurJnt"))


@pytest.mark.parametrize("data", [b"", b"\x02" * 20, b"\x01" * 8, bytearray(b"hello")])
def test_bytes_that_are_no_frame_are_a_remote_protocol_error(data: bytes) -> None:
    with pytest.raises(bcapscope.RemoteProtocolError) as caught:
        bcapscope.decode(data)
    assert caught.value.raw == data
