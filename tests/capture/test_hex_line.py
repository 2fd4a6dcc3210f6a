"""Lines taken apart: hex, words, or both."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.hex_line import (
    MIN_HEX_BYTES,
    EndOffset,
    HexDigits,
    LinePiece,
    ProseText,
    RepeatMark,
    parse_line,
)

EIGHT = "0152000000050000"


def alone(digits: str, offset: str = "", indent: int = 0, marked: bool = False) -> list[LinePiece]:
    """Make what a line of nothing but hex gives."""
    return [HexDigits(digits, offset, indent, True, marked or bool(offset), True, True)]


@pytest.mark.parametrize(
    ("line", "pieces"),
    [
        ("", []),
        ("   ", []),
        ("};", []),
        ("```", []),
        ("*", [RepeatMark()]),
        ("00000152", [EndOffset("00000152")]),
        ("  DEAD ", [EndOffset("DEAD")]),
        ("01 52 00", alone("015200")),
        ("\t01,52 ;00", alone("015200", indent=1)),
        ("01h 52H $00", alone("015200")),
        ("> >> 01 52 00", alone("015200", indent=1)),
        ("<td>01</td><td>52</td>", alone("0152", indent=1)),
        ("01&nbsp;52", alone("0152")),
        ("\uff10\uff11 52", alone("0152")),
        ("0x01, 0x52, 0x0,", [HexDigits("015200", "", 0, True, True, True, False)]),
        ("(byte)0x01, (byte)0x52 // ", [HexDigits("0152", "", 1, True, True, True, False)]),
        ("01-52-00-00", alone("01520000")),
        ("01:52:00:00", alone("01520000")),
        ("0152 0000 04", alone("0152000004")),
        ("015200000005000", alone("015200000005000")),
        ("0000   01 52 00  .R.", alone("015200", "0000")),
        ("0000   01 52 00  |.R.|", alone("015200", "0000")),
        ("0000020 41 42 20  >AB <", alone("414220", "0000020")),
        ("00000010: 4142 43                                  ABC", alone("414243", "00000010:")),
        ("\t0x0010:  4142 4300  ABC.", alone("41424300", "0010:", 1)),
        ("0010   61 62  ab", alone("6162", "0010")),
        ("61 62 ab", alone("6162ab")),
        ("61 62  ab", alone("6162")),
        ("0000000 5201 0000", alone("01520000", "0000000")),
        ("000000 00005201", alone("01520000", "000000")),
        ("0000000 051001 000004", alone("01520400", "0000000")),
        (r'"\x01\x52\x00" \ ', alone("015200", marked=True)),
        (r"\x01\x52", alone("0152", marked=True)),
        (r"'\x01R\n\\\0\''", alone("01520a5c0027", marked=True)),
        (r"b'\x01R'", alone("0152", marked=True)),
    ],
)
def test_lines_of_hex(line: str, pieces: list[LinePiece]) -> None:
    assert parse_line(line) == pieces


def test_strings_that_are_no_bytes_are_words() -> None:
    assert parse_line("'\\x01\u20ac'") == [ProseText("'\\x01\u20ac'")]


@pytest.mark.parametrize(
    "line",
    [
        "Add the Face DEAD of the Cafe: 0x101 and 600B",
        "at 22:13:20 on 12-34-56 from 02:00:c0:a8:00:0a",
        "the mode is 0x0202.",
        "caption",
        "\u9001\u4fe1",
        "->",
    ],
)
def test_words(line: str) -> None:
    (piece,) = parse_line(line)
    assert piece == ProseText(line)


def test_words_before_and_behind() -> None:
    line = "TX: 01 52 00 00 00 05 00 00 (and so on)"
    assert parse_line(line) == [
        ProseText("TX:"),
        HexDigits(EIGHT, "", 0, False, False, False, False),
        ProseText("(and so on)"),
    ]


def test_two_rows_in_a_line() -> None:
    first, send, second, receive = parse_line("TX 01 52 00 00 00 05 00 00. RX 01 10 00 00 00 05 00 00.")
    assert (first, second) == (ProseText("TX"), ProseText("RX"))
    assert isinstance(send, HexDigits)
    assert isinstance(receive, HexDigits)
    assert (send.digits, receive.digits) == (EIGHT, "0110000000050000")


def test_a_few_bytes_at_either_end_of_a_line_are_told_as_such() -> None:
    _, tail = parse_line("the value is 0x0001 0A 00")
    assert tail == HexDigits("0A00", "", 0, False, False, False, True)
    lead, _ = parse_line("00 04 is the end")
    assert lead == HexDigits("0004", "", 0, False, False, True, False)
    assert len("0A00") < 2 * MIN_HEX_BYTES


@given(st.text() | st.text("0123456789abcdefxABX \\\"'|:-.>*<&;/()", max_size=200))
def test_any_line_is_read(line: str) -> None:
    for piece in parse_line(line):
        if isinstance(piece, HexDigits):
            int(piece.digits, 16)
            assert not piece.offset.strip("0123456789abcdefABCDEF:")
