"""Frames as rows: what trees on paper and on screen share."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.frame_tree import MAX_ELEMENTS, FieldRow, FieldRowKind, field_rows, frame_sections
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Observation
from tests.render.scenes import ROBOT, observe, scenes
from tests.strategies import mutated_frames


def outline(seen: Observation, call_kind: CallKind | None = None, full: bool = False) -> list[FieldRow]:
    return [row for section in frame_sections(seen, call_kind) for row in field_rows(section, full)]


def test_a_row_has_depth_place_name_and_meaning() -> None:
    found = outline(observe(parse_datagram(encode_frame(5, 0, 64, (ROBOT,)))[0]))
    assert found[4] == FieldRow(FieldRowKind.LEAF, 0, 9, 13, "function id", "64 Robot_Execute")
    assert found[6][:5] == (FieldRowKind.FIELD, 0, 15, 29, "hRobot")
    assert found[7][:5] == (FieldRowKind.LEAF, 1, 15, 19, "length")


def test_only_an_hresult_fails_or_not() -> None:
    good, bad = (
        outline(observe(parse_datagram(encode_frame(5, 0, code))[0], Direction.RESPONSE))
        for code in (0, 0x83500121)
    )
    assert [row.failed for row in good if row.failed is not None] == [False]
    assert [row.failed for row in bad if row.failed is not None] == [True]
    assert any(row.kind is FieldRowKind.NOTE and row.text for row in bad)


def test_a_compressed_frame_has_two_sections() -> None:
    counts = {len(frame_sections(seen, call_kind)) for seen, call_kind in scenes()}
    assert counts == {1, 2}
    two = next(found for seen, call_kind in scenes() if len(found := frame_sections(seen, call_kind)) == 2)
    assert [bool(section.caption) for section in two] == [False, True]
    assert two[0].body != two[1].body


def test_long_arrays_are_shown_by_their_beginning_unless_all_is_asked_for() -> None:
    many = Variant.array(VT.I4, tuple(range(100)))
    seen = observe(parse_datagram(encode_frame(5, 0, 64, (ROBOT, many)))[0])
    short, full = outline(seen), outline(seen, full=True)
    assert sum(row.name.startswith("[") for row in short) == MAX_ELEMENTS
    assert sum(row.name.startswith("[") for row in full) == 100
    assert any(row.name == f"… {100 - MAX_ELEMENTS} more" for row in short)


def test_a_hole_has_a_problem_and_no_bytes() -> None:
    found = [outline(seen) for seen, _ in scenes() if isinstance(seen.item, Malformed) and seen.item.missing]
    assert found
    for one in found:
        assert {row.kind for row in one} == {FieldRowKind.LEAF, FieldRowKind.PROBLEM}
        assert {row.start == row.stop for row in one} == {True}


@given(mutated_frames(), st.sampled_from(Direction), st.booleans())
def test_leaves_of_any_bytes_lie_side_by_side(raw: bytes, direction: Direction, full: bool) -> None:
    for item in parse_datagram(raw):
        for section in frame_sections(observe(item, direction), None):
            end = -1
            for row in field_rows(section, full):
                assert row.text.isprintable() or "\u3000" in row.text
                assert 0 <= row.start <= row.stop <= len(section.body)
                if row.kind is FieldRowKind.LEAF:
                    assert end in (-1, row.start)
                    end = row.stop
