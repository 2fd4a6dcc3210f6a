"""Numbers with their nouns, and how wide a text is."""

from __future__ import annotations

import pytest

from bcapscope.protocol.text_format import counted, display_width, is_spreadsheet_formula, shortened


@pytest.mark.parametrize(
    ("text", "computed"),
    [
        ("=1", True),
        ("\u3000＝1", True),
        (" +1", True),
        ("\tx", True),
        ("", False),
        ("a=1", False),
        ("'=1", False),
    ],
)
def test_what_a_spreadsheet_computes(text: str, computed: bool) -> None:
    assert is_spreadsheet_formula(text) is computed


@pytest.mark.parametrize(("text", "shown"), [("", ""), ("abc", "abc"), ("abcd", "abc…")])
def test_a_long_text_is_shortened(text: str, shown: str) -> None:
    assert shortened(text, 3) == shown


def test_numbers_with_nouns() -> None:
    assert counted(1, "retry", "retries") == "1 retry"
    assert counted(2, "retry", "retries") == "2 retries"
    assert counted(0, "frame") == "0 frames"


@pytest.mark.parametrize(
    ("text", "width"),
    [("", 0), ("slvMove", 7), ("軸１", 4), ("e\u0301", 1), ("☎\ufe0f", 1), ("ｶ", 1), ("…", 1), ("→ ×", 3)],
)
def test_display_width(text: str, width: int) -> None:
    assert display_width(text) == width
