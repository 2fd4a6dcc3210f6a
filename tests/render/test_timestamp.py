"""Moments as text."""

from __future__ import annotations

import pytest

from bcapscope.render.timestamp import TimeFormat, epoch_text, timestamp_writer, utc_text

START = 1_700_000_000_123_456_789


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        (START, "1700000000.123456789"),
        (0, "0.000000000"),
        (1, "0.000000001"),
        (-1, "-0.000000001"),
        (-1_500_000_000, "-1.500000000"),
        (10**40, f"{10**31}.000000000"),
    ],
)
def test_epoch_keeps_every_nanosecond(time: int, expected: str) -> None:
    assert epoch_text(time) == expected


def test_utc() -> None:
    assert utc_text(START) == "2023-11-14T22:13:20.123456789Z"


def test_utc_beyond_the_calendar_is_a_number() -> None:
    assert utc_text(10**21) == "1000000000000.000000000"
    assert utc_text(-(10**21)) == "-1000000000000.000000000"


@pytest.mark.parametrize(
    ("clock", "expected"),
    [
        (TimeFormat.RELATIVE, ["    0.000000", "    1.000001", "   -0.500000", "12345.678901"]),
        (TimeFormat.DELTA, ["    0.000000", "    1.000001", "   -1.500001", "12346.178901"]),
        (
            TimeFormat.EPOCH,
            ["1700000000.123456789", "1700000001.123457789", "1699999999.623456789", "1700012345.802357789"],
        ),
    ],
)
def test_clocks(clock: TimeFormat, expected: list[str]) -> None:
    write = timestamp_writer(clock)
    moments = (START, START + 1_000_001_000, START - 500_000_000, START + 12_345_678_901_000)
    assert [write(moment) for moment in moments] == expected


def test_two_clocks_keep_their_own_beginning() -> None:
    one, two = timestamp_writer(TimeFormat.RELATIVE), timestamp_writer(TimeFormat.RELATIVE)
    one(START)
    assert two(START + 5) == one(START) == "    0.000000"
