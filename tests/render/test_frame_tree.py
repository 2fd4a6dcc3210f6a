"""Frames as trees."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.color_palette import ANSI, PLAIN
from bcapscope.render.frame_tree import MAX_ELEMENTS, FrameTreeRenderer
from bcapscope.traffic.observation import Direction
from tests.render.scenes import HOSTILE, ROBOT, observe, scenes
from tests.strategies import mutated_frames


def tree(raw: bytes, direction: Direction = Direction.REQUEST, *, full: bool = False) -> list[str]:
    (item,) = parse_datagram(raw)
    return list(FrameTreeRenderer(full=full).lines(observe(item, direction), None))


def everything(renderer: FrameTreeRenderer) -> Iterator[str]:
    for seen, call_kind in scenes():
        yield f"frame {seen.number}"
        yield from renderer.lines(seen, call_kind)


def test_trees_are_as_they_were(golden: Callable[[str, bytes], None]) -> None:
    golden("tree.txt", "\n".join(everything(FrameTreeRenderer())).encode() + b"\n")


def test_full_trees_with_hexdumps_are_as_they_were(golden: Callable[[str, bytes], None]) -> None:
    lines = everything(FrameTreeRenderer(palette=ANSI, full=True, dump=True))
    golden("tree-full.ansi", "\n".join(lines).encode() + b"\n")


def test_field_has_offsets_bytes_name_and_meaning() -> None:
    lines = tree(encode_frame(5, 0, 64, (ROBOT,)))
    assert lines[4] == " 9..12  40 00 00 00              function id          64 Robot_Execute"
    assert lines[-1] == "29      04                       EOT"


def test_no_line_is_wider_than_a_hundred_columns_without_long_texts() -> None:
    assert max(len(line) for line in everything(FrameTreeRenderer(dump=True)) if "\\x1b" not in line) <= 100


def test_colours_change_nothing_else() -> None:
    colored = everything(FrameTreeRenderer(ANSI, dump=True))
    plain = everything(FrameTreeRenderer(PLAIN, dump=True))
    for with_color, without in zip(colored, plain, strict=True):
        assert re.sub(r"\x1b\[[\d;]*m", "", with_color).rstrip() == without.rstrip()


def test_problem_stands_under_the_field_it_belongs_to() -> None:
    lines = tree(b"\x01\x20" + encode_frame(5, 0, 2)[2:])
    assert lines[1].split()[5:] == ["length", "32"]
    assert lines[2].split() == ["!!", "length", "is", "32,", "but", "there", "are", "16", "bytes"]


def test_every_problem_is_shown_once() -> None:
    for seen, call_kind in scenes():
        lines = list(FrameTreeRenderer().lines(seen, call_kind))
        shown = sorted(line.split("!! ")[1] for line in lines if "!! " in line)
        assert shown == sorted(str(problem.reason) for problem in seen.item.problems)


def test_problem_bytes_are_lit_in_the_hexdump() -> None:
    item = Frame(b"\x01\x20" + encode_frame(5, 0, 2)[2:])
    lines = list(FrameTreeRenderer(ANSI, dump=True).lines(observe(item), None))
    assert f"01 {ANSI.problem}20 00 00 00{ANSI.reset} 05" in lines[-1]


def test_long_fields_are_cut_unless_all_is_asked_for() -> None:
    raw = encode_frame(5, 0, 200, (Variant.array(VT.UI1, bytes(range(100))),))
    assert "  00 01 02 03 04 05 06 …  " in tree(raw)[-2]
    wanted = [line for line in tree(raw, full=True) if line.startswith(" " * 9)]
    assert bytes.fromhex("".join(wanted[-12:])) == bytes(range(8, 100))


def test_many_elements_are_cut_unless_all_is_asked_for() -> None:
    raw = encode_frame(5, 0, 200, (Variant.array(VT.I2, tuple(range(100))),))
    lines = tree(raw)
    assert sum("[" in line for line in lines) == MAX_ELEMENTS
    assert lines[-2].endswith(f"… {100 - MAX_ELEMENTS} more")
    assert lines[-2].startswith(" 89..224")
    assert sum("[" in line for line in tree(raw, full=True)) == 100


def test_problem_among_elements_that_are_cut_is_shown() -> None:
    raw = bytearray(encode_frame(5, 0, 200, (Variant.array(VT.BSTR, ("a",) * 50),)))
    raw[-7] = 1
    assert any("!! string length is 1" in line for line in tree(bytes(raw[:-2]) + b"\x04"))


@pytest.mark.parametrize(
    ("code", "style", "words"),
    [(0, ANSI.good, "S_OK"), (0x900, ANSI.good, "S_EXECUTING"), (0x80004005, ANSI.bad, "E_FAIL")],
)
def test_result_is_coloured_by_how_it_ended(code: int, style: str, words: str) -> None:
    seen = observe(Frame(encode_frame(5, 0, code)), Direction.RESPONSE)
    assert any(f"{style}{words}" in line for line in FrameTreeRenderer(ANSI).lines(seen, None))


def test_failure_comes_with_advice() -> None:
    lines = tree(encode_frame(5, 0, 0x83500121), Direction.RESPONSE)
    assert "0x83500121, slvMove while slave mode is off" in lines[4]
    assert "look for an earlier error" in lines[5]


@pytest.mark.parametrize("full", [False, True])
def test_hostile_strings_never_come_out_raw(full: bool) -> None:
    for line in everything(FrameTreeRenderer(full=full, dump=True)):
        assert line.isprintable()
    values = (Variant(VT.BSTR, HOSTILE), Variant.array(VT.BSTR, (HOSTILE,)))
    for line in tree(encode_frame(5, 0, 200, values), full=full):
        assert line.isprintable()


@given(mutated_frames(), st.sampled_from(Direction))
def test_any_frame_has_a_tree_with_all_its_bytes(raw: bytes, direction: Direction) -> None:
    for item in parse_datagram(raw):
        if not isinstance(item, Frame) or item.reserved == 1:
            continue
        column = 2 * len(str(len(item.raw))) + 4
        lines = list(FrameTreeRenderer(full=True).lines(observe(item, direction), None))
        assert all(line.isprintable() for line in lines)
        assert bytes.fromhex("".join(line[column : column + 24] for line in lines)) == item.raw
