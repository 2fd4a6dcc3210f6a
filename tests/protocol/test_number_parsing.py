"""Numbers that people type."""

from __future__ import annotations

import pytest

from bcapscope.protocol.number_parsing import parse_integer, parse_number


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("7", 7),
        (" -7 ", -7),
        ("+7", 7),
        ("010", 10),
        ("0x10", 16),
        ("-0X1f", -31),
        ("0" * 39 + "7", 7),
        ("0" * 40 + "7", None),
        ("100", 100),
        ("101", None),
        ("-100", -100),
        ("-101", None),
        ("", None),
        ("7.0", None),
        ("7_0", None),
        ("\uff17", None),
        ("0x", None),
    ],
)
def test_integers(text: str, number: int | None) -> None:
    assert parse_integer(text, -100, 100) == number


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("7", 7.0),
        (" -.5 ", -0.5),
        ("1e2", 100.0),
        ("1.", 1.0),
        ("0" * 39 + "7", 7.0),
        ("0" * 40 + "7", None),
        ("100.5", None),
        ("-100", -100.0),
        ("-100.5", None),
        ("1e999", None),
        ("inf", None),
        ("nan", None),
        ("", None),
        (".", None),
        ("0x10", None),
    ],
)
def test_numbers(text: str, number: float | None) -> None:
    assert parse_number(text, -100, 100) == number
