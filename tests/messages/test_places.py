"""Text of typed values."""

from __future__ import annotations

import pytest

from bcapscope.analysis.finding_places import client_place
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Duration, Moment, Quantity, Times, WireText
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport


@pytest.mark.parametrize(
    ("nanoseconds", "text"),
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
def test_durations(nanoseconds: int, text: str) -> None:
    assert Duration(nanoseconds).text(ENGLISH_WORDS) == text


def test_amounts_that_people_read_have_no_exponent() -> None:
    values = (0.0123456, -1.5, 125.0, 999.4, 999.6, -1234.5, 1e6, 1e200)
    texts = [Quantity(value).text(ENGLISH_WORDS) for value in values]
    assert texts == ["0.0123", "-1.5", "125", "999", "1000", "-1234", "1000000", "1e+200"]


def test_counts_of_events() -> None:
    assert [Times(n).text(ENGLISH_WORDS) for n in (1, 2, 3)] == ["once", "twice", "3 times"]


def test_long_names_are_cut() -> None:
    assert WireText("x" * 60).text(ENGLISH_WORDS) == "x" * 60
    assert WireText("x" * 61).text(ENGLISH_WORDS) == "x" * 60 + "…"


def test_clients_are_named_where_there_are_several() -> None:
    one = Conversation(Endpoint("fd00::a", 50001), Endpoint("fd00::1", 5007), Transport.TCP, SERVER_PORT)
    words = MessageFormatter(start=1_000_000_000, only_client=False)
    assert client_place(one).text(ENGLISH_WORDS) == "your client"
    assert client_place(one).text(words) == "client [fd00::a]:50001 (TCP)"
    assert Moment(13_431_000_000).text(words) == "12.431 s"
