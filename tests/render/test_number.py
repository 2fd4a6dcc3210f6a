"""Numbers as text: exact and short."""

from __future__ import annotations

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bcapscope.render.number import currency_text, date_text, numbers_text, single_text, singles_text

LARGEST_SINGLE = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]


@given(st.floats(width=32, allow_nan=False) | st.just(LARGEST_SINGLE))
@example(999999995904.0)  # has fewer digits as 1000000000000.0, and more characters
def test_single_text_reads_back_as_the_same_and_is_no_longer_than_needed(value: float) -> None:
    text = single_text(value)
    assert struct.pack("<f", float(text)) == struct.pack("<f", value)
    assert _digits(text) <= _digits(repr(value))


def _digits(text: str) -> int:
    """Count the digits that matter; zeros at either end only tell how great the number is."""
    return len(text.partition("e")[0].replace(".", "").strip("-0"))


@given(st.lists(st.floats(width=32), max_size=10))
def test_several_are_written_as_one_by_one(values: list[float]) -> None:
    assert singles_text(tuple(values)) == ",".join(map(single_text, values))


@given(st.lists(st.floats() | st.integers(-(2**63), 2**64 - 1)))
def test_plain_texts_read_back_as_the_same(values: list[float]) -> None:
    text = numbers_text(tuple(values))
    assert [repr(type(value)(part)) for value, part in zip(values, text.split(","), strict=False)] == [
        repr(value) for value in values
    ]


@pytest.mark.parametrize(
    ("raw", "expected"), [(123456, "12.3456"), (-1, "-0.0001"), (0, "0"), (2**63 - 1, "922337203685477.5807")]
)
def test_cy_is_in_ten_thousandths(raw: int, expected: str) -> None:
    assert currency_text(raw) == expected


@pytest.mark.parametrize(
    ("days", "expected"),
    [
        (0.0, "1899-12-30 00:00:00"),
        (25569.0, "1970-01-01 00:00:00"),
        (39873.5, "2009-03-01 12:00:00"),
        (2958465.999, "9999-12-31 23:58:33"),
        (2958466.0, ""),
        (-0.5, ""),
        (float("nan"), ""),
        (float("inf"), ""),
    ],
)
def test_dates(days: float, expected: str) -> None:
    assert date_text(days) == expected
