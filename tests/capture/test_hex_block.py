"""Rows that belong together, by their offsets."""

import pytest

from bcapscope.capture.hex_block import HexBlock
from bcapscope.capture.hex_line import HexDigits

ROW = "41" * 16


def row(digits: str = ROW, offset: str = "") -> HexDigits:
    return HexDigits(digits, offset, 2, True, bool(offset), True, True)


def block(*rows: tuple[str, str]) -> HexBlock:
    """Make a block of rows: offset and digits."""
    made = HexBlock("caption", None, True, row(offset=rows[0][0]))
    for line, (offset, digits) in enumerate(rows, 10):
        made.add(line, row(digits, offset))
    return made


def test_rows_one_behind_the_other() -> None:
    made = block(("", "01 52".replace(" ", "")), ("", "00"))
    assert (made.data, made.size, made.line_numbers()) == (b"\x01\x52\x00", 3, [(0, 10), (2, 11)])
    assert (made.starts_at_zero, made.has_hex_notation, made.indent) == (False, False, -1)


@pytest.mark.parametrize("offset", ["0010", "00000010:", "0000016", "0000020"])
def test_the_next_offset_in_any_base(offset: str) -> None:
    made = block(("0" * len(offset), ROW))
    assert made.starts_at_zero
    assert made.fit_to_offset(offset, 11)
    assert made.notes == []


def test_the_base_is_settled_by_the_first_that_fits() -> None:
    made = block(("0000000", ROW))
    assert made.fit_to_offset("0000020", 11)
    made.add(11, row(offset="0000020"))
    assert made.fit_to_offset("0000040", 12)
    assert not made.fit_to_offset("0000020", 12)


@pytest.mark.parametrize("offset", ["0000", "0008", "000g", "5000"])
def test_offsets_that_belong_elsewhere(offset: str) -> None:
    made = block(("0000", ROW), ("0010", ROW))
    assert not made.fit_to_offset(offset, 12)
    assert made.size == 32


def test_a_block_that_begins_in_the_middle() -> None:
    made = block(("0052", ROW))
    assert not made.starts_at_zero
    assert made.fit_to_offset("0062", 11)


def test_characters_taken_for_hex_are_dropped() -> None:
    made = block(("0000", ROW), ("0010", ROW + "abab"))
    assert made.fit_to_offset("0020", 12)
    assert made.data == b"A" * 32


def test_an_asterisk_stands_for_rows_like_the_last() -> None:
    made = block(("0000", ROW))
    made.asterisk_bytes = 48
    assert made.data == b"A" * 16
    assert made.fit_to_offset("0040", 12)
    assert made.data == b"A" * 64
    assert made.asterisk_bytes == 0


def test_rows_that_are_missing_are_told_once() -> None:
    made = block(("0000", ROW))
    assert made.fit_to_offset("0020", 11)
    made.add(11, row(offset="0020"))
    assert made.fit_to_offset("0030", 12)
    assert list(map(str, made.notes)) == ["16 bytes missing in the text before line 11"]


def test_two_blocks_put_together() -> None:
    made, more = block(("", ROW)), block(("", "04"))
    made.extend(more)
    assert made.data == b"A" * 16 + b"\x04"
    assert made.line_numbers() == [(0, 10), (16, 10)]
