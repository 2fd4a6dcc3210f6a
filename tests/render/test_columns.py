"""Text in columns, on terminals of any script."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.text_format import display_width
from bcapscope.render.columns import align_columns, fit_line, fold_line, wrap_text


def test_columns_are_as_wide_as_their_widest_cell() -> None:
    rows = [("name", "n"), ("軸", "10"), ("slvMove", "1")]
    assert list(align_columns(rows, "<>")) == [
        "name      n",
        "軸       10",
        "slvMove   1",
    ]


def test_the_last_column_is_not_filled_up() -> None:
    assert list(align_columns([("a", ""), ("", "long"), ("", "")], "><")) == ["a", "   long", ""]


def test_no_rows() -> None:
    assert list(align_columns([], "<>")) == []


@given(st.lists(st.lists(st.text("a軸 ", max_size=5), min_size=3, max_size=3), max_size=6))
def test_columns_begin_and_end_below_each_other(rows: list[list[str]]) -> None:
    framed = [[f"|{cell}|" for cell in row] for row in rows]
    found = list(align_columns(framed, "<>>"))
    assert len(found) == len(rows)
    ends = {display_width(line) for line in found}
    assert len(ends) <= 1
    for line, row in zip(found, framed, strict=True):
        assert line.startswith(row[0])
        assert line.endswith(row[2])


@pytest.mark.parametrize(
    ("text", "width", "expected"),
    [
        ("", 10, [""]),
        ("one two three", 7, ["one two", "three"]),
        ("one two three", 6, ["one", "two", "three"]),
        ("a_word_that_is_long x", 4, ["a_word_that_is_long", "x"]),
        ("軸 軸 軸", 5, ["軸 軸", "軸"]),
        ("先にエラーを読み", 8, ["先にエ", "ラーを読", "み"]),
        ("値は 1.5 です、次", 8, ["値は 1.5", "です、次"]),
        ("動作中、停止", 6, ["動作", "中、停", "止"]),
    ],
)
def test_wrapped(text: str, width: int, expected: list[str]) -> None:
    assert list(wrap_text(text, width)) == expected


@given(st.text("ab ", max_size=60), st.integers(1, 20))
def test_wrapping_loses_nothing(text: str, width: int) -> None:
    lines = list(wrap_text(text, width))
    assert " ".join(lines).split() == text.split()
    assert all(display_width(line) <= width or " " not in line for line in lines)


WORDS = st.lists(st.text("abcあい", min_size=1, max_size=30), max_size=20)


@given(WORDS, st.integers(40, 90), st.booleans())
def test_a_folded_line_fits_and_loses_nothing(words: list[str], width: int, coloured: bool) -> None:
    line = " ".join(f"\x1b[1m{word}\x1b[0m" if coloured else word for word in words)
    folded = fold_line(line, width)
    plain = folded.replace("\x1b[1m", "").replace("\x1b[0m", "")
    assert all(display_width(row) <= width for row in plain.split("\n"))
    assert "".join(plain.split()) == "".join(words)
    assert folded.count("\x1b[1m") == line.count("\x1b[1m")


@pytest.mark.parametrize(
    ("line", "width", "folded"),
    [
        ("short", 40, "short"),
        ("x" * 41, 10, "x" * 41),  # too narrow to fold
        (f"{'a' * 30} {'b' * 20}", 40, f"{'a' * 30}\n       {'b' * 20}"),
        ("c" * 90, 40, f"{'c' * 40}\n       {'c' * 33}\n       {'c' * 17}"),
    ],
)
def test_where_a_line_is_folded(line: str, width: int, folded: str) -> None:
    assert fold_line(line, width) == folded


@given(st.text("abcあい", max_size=60), st.integers(1, 70))
def test_a_fitted_line_ends_with_an_ellipsis(line: str, width: int) -> None:
    fitted = fit_line(line, width)
    assert display_width(fitted) <= max(width, 3)
    assert fitted == line or (fitted[-1] == "…" and line.startswith(fitted[:-1]))
