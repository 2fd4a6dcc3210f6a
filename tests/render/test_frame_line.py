"""Lines: one a frame, whatever the frame."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.color_palette import ANSI
from bcapscope.render.frame_line import LONGEST_STRING, MAX_ELEMENTS, MAX_TEMPLATES, FrameLineRenderer
from bcapscope.traffic.call_kind import CallKind, call_kind_of
from bcapscope.traffic.observation import Direction
from tests.render.scenes import JOINTS, ROBOT, observe, scenes
from tests.samples.problems import problem_of
from tests.strategies import variants

ASK, ANSWER = Direction.REQUEST, Direction.RESPONSE
EXECUTE = CallKind(64, "slvMove")


def text_of(raw: bytes, direction: Direction = ASK, call_kind: CallKind | None = None) -> str:
    """Return what a line says behind serial and reserved."""
    (item,) = parse_datagram(raw)
    assert isinstance(item, Frame)
    if call_kind is None and direction is ASK:
        call_kind = call_kind_of(item)
    line = FrameLineRenderer().line(observe(item, direction), call_kind)
    return line.split(f" {item.serial:>5} {item.reserved:>5}  ", 1)[1]


def put(value: Variant) -> bytes:
    return encode_frame(5, 0, 102, (ROBOT, value))


def test_all_scenes(golden: Callable[[str, bytes], None]) -> None:
    renderer = FrameLineRenderer()
    lines = [renderer.line(seen, call_kind) for seen, call_kind in scenes()]
    golden("lines.txt", "".join(f"{line}\n" for line in lines).encode())


def test_all_scenes_in_colour(golden: Callable[[str, bytes], None]) -> None:
    renderer = FrameLineRenderer(palette=ANSI)
    lines = [renderer.line(seen, call_kind) for seen, call_kind in scenes()]
    golden("lines.ansi", "".join(f"{line}\n" for line in lines).encode())


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (Variant(VT.EMPTY, None), "EMPTY"),
        (Variant(VT.NULL, None), "NULL"),
        (Variant(VT.I2, -2), "I2(-2)"),
        (Variant(VT.I4, 514), "I4(514)"),
        (Variant(VT.R4, 0.10000000149011612), "R4(0.1)"),
        (Variant(VT.R8, 0.1), "R8(0.1)"),
        (Variant(VT.R8, float("nan")), "R8(nan)"),
        (Variant(VT.CY, 123456), "CY(123456 12.3456)"),
        (Variant(VT.DATE, 39873.5), "DATE(39873.5 2009-03-01 12:00:00)"),
        (Variant(VT.DATE, -1.5), "DATE(-1.5)"),
        (Variant(VT.ERROR, -2147024890), "ERROR(E_HANDLE)"),
        (Variant(VT.BOOL, True), "true"),
        (Variant(VT.BSTR, 'a"%s\n'), '"a\\"%s\\n"'),
        (Variant.array(VT.R8, (1.5, float("inf"))), "R8[1.5,inf]"),
        (Variant.array(VT.R4, (1.5, 0.25)), "R4[1.5,0.25]"),
        (Variant.array(VT.I4, ()), "I4[]"),
        (Variant.array(VT.UI1, b"\x00\xff"), "UI1[00ff]"),
        (Variant.array(VT.BOOL, (True, False)), "BOOL[true,false]"),
        (Variant.array(VT.BSTR, ("a", "")), 'BSTR["a",""]'),
        (Variant.array(VT.VARIANT, (Variant.array(VT.R8, (1.0,)), Variant(VT.I4, 2))), "[R8[1.0],I4(2)]"),
    ],
)
def test_values(value: Variant, expected: str) -> None:
    assert text_of(put(value)) == f"Variable_PutValue hVariable=1 newVal={expected}"


def test_a_type_is_named_only_where_the_function_does_not_prescribe_it() -> None:
    assert text_of(encode_frame(1, 0, 115, (ROBOT, Variant(VT.I4, 7)))).endswith("newVal=7")
    assert text_of(encode_frame(1, 0, 115, (ROBOT, Variant(VT.I2, 7)))).endswith("newVal=I2(7)")


def test_what_is_long_is_shortened_and_says_so() -> None:
    many = Variant.array(VT.I4, tuple(range(MAX_ELEMENTS + 5)))
    assert text_of(put(many)).endswith(f",{MAX_ELEMENTS - 1},… 5 more]")
    deep = Variant.array(VT.VARIANT, (many,) * (MAX_ELEMENTS + 2))
    assert text_of(put(deep)).endswith(",… 2 more]")
    assert text_of(put(Variant(VT.BSTR, "x" * (LONGEST_STRING + 3)))).endswith('x"… 3 more')
    assert text_of(put(Variant.array(VT.UI1, bytes(LONGEST_STRING)))).endswith(
        f"… {LONGEST_STRING // 2} more]"
    )


@pytest.mark.parametrize(
    ("code", "call_kind", "expected"),
    [
        (0, EXECUTE, "S_OK Robot_Execute slvMove"),
        (0, None, "S_OK"),
        (0x0F200501, EXECUTE, "S_BUF_FULL Robot_Execute slvMove"),
        (0x80070006, EXECUTE, "E_HANDLE (handle is not valid) Robot_Execute slvMove"),
    ],
)
def test_results(code: int, call_kind: CallKind | None, expected: str) -> None:
    assert text_of(encode_frame(5, 0, code), ANSWER, call_kind) == expected


def test_a_result_has_the_name_that_its_function_gives_it() -> None:
    reply = encode_frame(5, 0, 0, (Variant(VT.I4, 3),))
    assert text_of(reply, ANSWER, CallKind(7, None)).endswith("Controller_GetRobot hRobot=3")
    assert text_of(reply, ANSWER, CallKind(64, "CurJnt")).endswith("CurJnt pVal=I4(3)")


def test_problems_stand_at_the_end() -> None:
    line = text_of(encode_frame(13, 0, 4, (ROBOT,))[:-1])
    assert line.startswith("Controller_Disconnect hController=1 !! ")
    assert "length is 30, but there are 29 bytes (at 1)" in line


def test_malformed_bytes_are_shown() -> None:
    item = Malformed(b"\x1b[2J" + bytes(100), (problem_of(0, "soh", "first byte is 1B"),))
    line = FrameLineRenderer().line(observe(item), None)
    assert "\x1b" not in line
    assert "  1b 5b 32 4a 00" in line
    assert line.endswith("… 56 more bytes !! first byte is 1B")


def test_frames_of_one_layout_keep_their_own_numbers() -> None:
    renderer = FrameLineRenderer()
    lines = []
    for handle in (1, 2, 1):
        for value in (1.5, 2.5):
            frame = Frame(encode_frame(5, 0, 102, (Variant(VT.I4, handle), Variant(VT.R8, value))))
            lines.append(renderer.line(observe(frame), call_kind_of(frame)).split("hVariable=")[1])
    assert lines == [f"{h} newVal=R8({v})" for h in (1, 2, 1) for v in (1.5, 2.5)]


def test_phrases_are_forgotten_in_time() -> None:
    renderer = FrameLineRenderer()
    for number in range(MAX_TEMPLATES + 10):
        frame = Frame(encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, f"c{number}"), JOINTS)))
        renderer.line(observe(frame), call_kind_of(frame))
        assert len(renderer._templates) <= MAX_TEMPLATES


@given(st.lists(variants(), max_size=4), st.sampled_from(Direction), st.integers(0, 2**32 - 1))
def test_any_frame_is_one_harmless_line(values: list[Variant], direction: Direction, code: int) -> None:
    raw = encode_frame(5, 0, code, values)
    assert_harmless(raw, direction)


@given(st.binary(max_size=120), st.sampled_from(Direction))
def test_any_bytes_are_harmless_lines(raw: bytes, direction: Direction) -> None:
    assert_harmless(raw, direction)


def assert_harmless(raw: bytes, direction: Direction) -> None:
    for item in parse_datagram(raw):
        call_kind = call_kind_of(item) if isinstance(item, Frame) else None
        line = FrameLineRenderer().line(observe(item, direction), call_kind)
        line.encode("utf-8")
        assert not [char for char in line if unicodedata.category(char)[0] == "C"]
