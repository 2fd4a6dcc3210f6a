"""What stands beside numbers and strings that have a meaning."""

from __future__ import annotations

import pytest
from hypothesis import given

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.dissection.frame_field import FrameField, frame_fields
from bcapscope.protocol.dissection.value_labels import NO_LABEL, argument_label, result_label
from tests.strategies import variants

ONE = Variant(VT.I4, 1)
JOINTS = Variant.array(VT.R8, (0.0, 10.0, 80.0, 0.0, 90.0, 0.0))


def bstr(value: str) -> Variant:
    return Variant(VT.BSTR, value)


def mixed(*items: Variant) -> Variant:
    return Variant.array(VT.VARIANT, items)


def arguments(code: int, *given: Variant) -> tuple[FrameField, ...]:
    return frame_fields(Frame(encode_frame(1, 0, code, given)), is_request=True)[6:-1]


@pytest.mark.parametrize(
    ("code", "given", "texts"),
    [
        (72, (ONE, Variant(VT.I4, 2), bstr("@E P1"), bstr("Speed=50")),
         ["handle of a Robot", "L (linear)", "", "speed in percent"]),
        (74, (ONE, Variant(VT.I4, -1), Variant(VT.R4, 50.0)), ["handle of a Robot", "tool tip", ""]),
        (74, (ONE, Variant(VT.I4, 3), Variant(VT.R4, 50.0)), ["handle of a Robot", "", ""]),
        (88, (ONE, ONE, bstr("")), ["handle of a Task", "one cycle", ""]),
        (89, (ONE, ONE, bstr("")), ["handle of a Task", "instant", ""]),
        (1, (bstr(",WDT=400"),), ["ms between two notices"]),
        (1, (bstr(",WDT=400,InvokeTimeout=9000"),),
         ["WDT: ms between two notices; InvokeTimeout: ms that a call may run"]),
        (3, (bstr(""), bstr("caoprov.denso.vrc"), bstr("localhost"), bstr("")),
         ["", "RC8, RC8A, COBOTTA", "", ""]),
        (17, (ONE, bstr("PutAutoMode"), Variant(VT.I4, 2)),
         ["handle of a Controller", "", "external automatic"]),
        (17, (ONE, bstr("SetMode"), Variant(VT.I4, 2)), ["handle of a Controller", "", ""]),
    ],
)  # fmt: skip
def test_what_arguments_stand_for(code: int, given: tuple[Variant, ...], texts: list[str]) -> None:
    assert [str(each.text) for each in arguments(code, *given)] == texts


@pytest.mark.parametrize(
    ("code", "command", "value", "text"),
    [
        (87, "GetStatus", 3, "running"),
        (17, "SysState", 0x404, "servo on, emergency stop"),
        (64, "GetStatus", 3, ""),
        (7, None, 3, "handle of a Robot"),
    ],
)
def test_what_results_stand_for(code: int, command: str | None, value: int, text: str) -> None:
    reply = Frame(encode_frame(1, 0, 0, (Variant(VT.I4, value),)))
    assert str(frame_fields(reply, False, code, command)[6].text) == text


def parts_of(found: FrameField) -> list[tuple[str, str]]:
    return [(each.name, str(each.text)) for each in found.children[-1].children]


@pytest.mark.parametrize(
    ("type_", "passing", "texts"),
    [(bstr("j"), bstr("@E"), ["", ""]), (Variant(VT.I4, 2), Variant(VT.I4, -2), ["J", "@E"])],
)
def test_the_parts_of_a_pose(type_: Variant, passing: Variant, texts: list[str]) -> None:
    pose = arguments(72, ONE, ONE, mixed(JOINTS, type_, passing), bstr(""))[2]
    assert parts_of(pose) == [("numbers", ""), ("pose type", texts[0]), ("pass", texts[1])]
    numbers = pose.children[-1].children[0].children[-1].children
    assert [(each.name, each.unit) for each in numbers] == [(f"J{axis}", "deg") for axis in range(1, 7)]


def test_a_mixed_array_without_numbers_in_front_is_no_pose() -> None:
    pose = arguments(72, ONE, ONE, mixed(ONE, Variant(VT.I4, 2), Variant(VT.I4, -2)), bstr(""))[2]
    assert {parts for parts in parts_of(pose)} == {("[0]", ""), ("[1]", ""), ("[2]", "")}


def test_the_parts_of_an_approach() -> None:
    distance = Variant(VT.R4, 20.0)
    given = mixed(ONE, mixed(JOINTS, Variant(VT.I4, 2), Variant(VT.I4, 10)), distance)
    found = arguments(64, ONE, bstr("Approach"), given)[2]
    assert parts_of(found) == [("interpolation", "P (PTP)"), ("pose", ""), ("distance", "")]
    pose = found.children[-1].children[1]
    assert parts_of(pose)[1:] == [("pose type", "J"), ("pass", "@10")]


@pytest.mark.parametrize(
    ("code", "command", "name", "elements"),
    [
        (64, "approach", "vntParam", 3),
        (64, "APPROACH", "vntParam", 4),
        (64, "Approach", "vntParam", 2),
        (64, "Depart", "vntParam", 3),
        (17, "Approach", "vntParam", 3),
        (64, "Approach", "arg3", 3),
    ],
)
def test_only_approach_of_a_robot_takes_an_interpolation_a_pose_and_a_distance(
    code: int, command: str, name: str, elements: int
) -> None:
    given = mixed(*[ONE, mixed(JOINTS, ONE), Variant(VT.R4, 20.0), ONE][:elements])
    label = argument_label(code, command, name, given)
    is_approach = code == 64 and command.lower() == "approach" and name == "vntParam" and elements > 2
    assert [each.name for each in label.elements] == (
        ["interpolation", "pose", "distance"] if is_approach else []
    )


def test_a_pose_has_a_label_for_each_of_four_elements() -> None:
    pose = argument_label(72, None, "vntPose", mixed(JOINTS, ONE, ONE, JOINTS))
    assert [each.name for each in pose.elements] == ["numbers", "pose type", "pass", "extra axes"]


@given(variants())
def test_nothing_is_said_of_what_nobody_knows(variant: Variant) -> None:
    assert not argument_label(None, None, "arg1", variant).text
    assert not result_label(None, None, "pVal", variant).text
    for code, command, name in (
        (72, None, "vntPose"),
        (64, "Approach", "vntParam"),
        (3, None, "bstrProvider"),
    ):
        argument_label(code, command, name, variant)
    assert argument_label(72, None, "vntPose", EMPTY) is NO_LABEL
