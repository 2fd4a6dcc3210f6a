"""Escaping: what comes from the wire is shown, never obeyed."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.render.escape import printable, quoted


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("slvMove", "slvMove"),
        ("軸　１", "軸　１"),
        ("\U0001f916", "\U0001f916"),
        ("\x1b[31m", "\\x1b[31m"),
        ("\x9b31m", "\\x9b31m"),
        ("a\nb\rc\td\0e", "a\\nb\\rc\\td\\0e"),
        ("\x7f", "\\x7f"),
        ("\u202egpj", "\\u202egpj"),
        ("\u2066x\u2069", "\\u2066x\\u2069"),
        ("\u2028\u2029\u200b\ufeff", "\\u2028\\u2029\\u200b\\ufeff"),
        ("\ud800a", "\\ud800a"),
        ("\U000e0041", "\\U000e0041"),
        ("\ue000", "\\ue000"),
        ("\xa0", "\\xa0"),
    ],
)
def test_printable(text: str, expected: str) -> None:
    assert printable(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"), [('a"b', '"a\\"b"'), ("a\\nb", '"a\\\\nb"'), ("a\nb", '"a\\nb"'), ("", '""')]
)
def test_quoted_tells_an_escape_from_a_backslash(text: str, expected: str) -> None:
    assert quoted(text) == expected


@given(st.text(st.characters()))
def test_nothing_of_another_category_gets_through(text: str) -> None:
    shown = printable(text)
    shown.encode("utf-8")
    assert not [char for char in shown if unicodedata.category(char)[0] == "C"]
    assert not [char for char in shown if unicodedata.category(char) in ("Zl", "Zp")]
