"""Words for times and counts."""

from __future__ import annotations

import pytest

from bcapscope.analysis.speech import Speech, amount, shown, span, times
from bcapscope.traffic.observation import Conversation, Endpoint, Transport


@pytest.mark.parametrize(
    ("nanoseconds", "words"),
    [
        (0, "0.00 ms"),
        (40_000, "0.04 ms"),
        (700_000, "0.7 ms"),
        (2_040_000, "2.0 ms"),
        (9_949_999, "9.9 ms"),
        (9_960_000, "10 ms"),
        (19_000_000, "19 ms"),
        (999_400_000, "999 ms"),
        (999_600_000, "1 s"),
        (1_370_000_000, "1.37 s"),
        (12_000_000_000, "12 s"),
        (4_000_000_000_000, "4000 s"),
    ],
)
def test_durations(nanoseconds: int, words: str) -> None:
    assert span(nanoseconds) == words


def test_amounts_that_people_read_have_no_exponent() -> None:
    texts = [amount(value) for value in (0.0123456, -1.5, 125.0, 999.4, 999.6, -1234.5, 1e6, 1e200)]
    assert texts == ["0.0123", "-1.5", "125", "999", "1000", "-1234", "1000000", "1e+200"]


def test_counts() -> None:
    assert [times(1), times(2), times(3)] == ["once", "twice", "3 times"]


def test_long_names_are_cut() -> None:
    assert shown("x" * 60) == "x" * 60
    assert shown("x" * 61) == "x" * 60 + "…"


def test_clients_are_named_where_there_are_several() -> None:
    one = Conversation(Endpoint("fd00::a", 50001), Endpoint("fd00::1", 5007), Transport.TCP, "port 5007")
    assert Speech(0, True).client(one) == "your client"
    assert Speech(0, False).client(one) == "client [fd00::a]:50001 (TCP)"
    assert Speech(1_000_000_000, True).at(13_431_000_000) == "12.431 s"
