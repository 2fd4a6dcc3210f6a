"""Bytes as lines."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.render.color_palette import ANSI, Palette
from bcapscope.render.hexdump import Highlight, hexdump


def test_sixteen_bytes_a_line_with_a_gap_in_the_middle() -> None:
    assert list(hexdump(bytes(range(0x3A, 0x3A + 18)))) == [
        "     0  3a 3b 3c 3d 3e 3f 40 41  42 43 44 45 46 47 48 49  :;<=>?@ABCDEFGHI",
        "    16  4a 4b                                             JK",
    ]


def test_eight_bytes_a_line_where_there_is_little_room() -> None:
    assert list(hexdump(b"0123456789", per_line=8)) == [
        "     0  30 31 32 33 34 35 36 37  01234567",
        "     8  38 39                    89",
    ]


def test_no_bytes_no_lines() -> None:
    assert list(hexdump(b"")) == []


def test_only_ascii_that_can_be_seen_is_shown_as_text() -> None:
    for byte in range(256):
        (line,) = hexdump(bytes([byte]))
        assert line[-1] == (chr(byte) if 0x20 <= byte <= 0x7E else ".")


def test_offsets_begin_where_told() -> None:
    assert [line.partition("  00")[0] for line in hexdump(bytes(17), first=999_999)] == [" 999999", "1000015"]


def test_highlight_covers_blanks_between_its_bytes_only() -> None:
    marks = [Highlight(1, 3, "<"), Highlight(6, 10, "<")]
    assert list(hexdump(b"ABCDEFGHIJ", marks, Palette(reset=">"))) == [
        "     0>  41 <42 43> 44 45 46 <47 48  49 4a>                    A<BC>DEF<GHIJ>"
    ]


def test_highlight_over_several_lines() -> None:
    lines = list(hexdump(bytes(48), [Highlight(15, 33, "<")], Palette(reset=">")))
    assert [line.count("<") for line in lines] == [2, 2, 2]
    assert "00 <00>  " in lines[0]
    assert "  <00> 00 " in lines[2]


def test_later_highlight_counts_where_two_overlap() -> None:
    (line,) = hexdump(bytes(3), [Highlight(0, 3, "a"), Highlight(1, 2, "b")], Palette(reset=">"))
    assert "a00> b00> a00>" in line


@given(
    st.binary(max_size=70),
    st.lists(st.tuples(st.integers(0, 80), st.integers(0, 80)).map(sorted), max_size=4).map(sorted),
)
def test_highlights_never_change_what_is_shown(data: bytes, spans: list[list[int]]) -> None:
    marks = [Highlight(start, stop, ANSI.problem) for start, stop in spans]
    shown = [re.sub(r"\x1b\[[\d;]*m", "", line) for line in hexdump(data, marks, ANSI)]
    assert shown == list(hexdump(data))
    assert bytes.fromhex("".join(line[8:57] for line in shown)) == data
