"""Durations, shares, rates, codes, conditions and spans: read, refused, and written back."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults.quantities import (
    DurationQuantity,
    FrameCondition,
    HresultQuantity,
    Rate,
    Share,
    Span,
    read_path,
)
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED, E_FAIL
from bcapscope.traffic.filter.compiler import FilterError


@pytest.mark.parametrize(
    ("kind", "written", "value"),
    [
        (DurationQuantity, "3ms", 3_000_000),
        (DurationQuantity, "1.5 s", 1_500_000_000),
        (DurationQuantity, "200us", 200_000),
        (DurationQuantity, "7µs", 7000),
        (DurationQuantity, "12ns", 12),
        (DurationQuantity, 0, 0),
        (DurationQuantity, "31536000s", 365 * 86_400 * 10**9),
        (Share, "5%", 0.05),
        (Share, "0.1 %", 0.001),
        (Share, 0.25, 0.25),
        (Share, 1, 1.0),
        (Rate, "64kbit/s", 8000.0),
        (Rate, "8kB/s", 8000.0),
        (Rate, "1.5Mbit/s", 187_500.0),
        (Rate, "100B/s", 100.0),
        (HresultQuantity, "E_FAIL", E_FAIL),
        (HresultQuantity, "e_accessdenied", E_ACCESSDENIED),
        (HresultQuantity, "0x80004005", E_FAIL),
        (HresultQuantity, -2147467259, E_FAIL),
        (HresultQuantity, "-2147467259", E_FAIL),
        (HresultQuantity, -(2**31), 2**31),
        (Span, "-1e19..1e19", Span(-1e19, 1e19)),
    ],
)
def test_reading(kind: Any, written: object, value: object) -> None:
    assert kind.read(written) == value


@pytest.mark.parametrize(
    ("kind", "written", "reason"),
    [
        (DurationQuantity, 3, "3 is not a duration such as 3ms"),
        (DurationQuantity, True, "True is not a duration"),
        (DurationQuantity, "3", "is not a duration"),
        (DurationQuantity, "3 min", "is not a duration"),
        (DurationQuantity, "-3ms", "is not a duration"),
        (DurationQuantity, "31536000.000000001s", "is longer than a year"),
        (DurationQuantity, None, "is not a duration"),
        (Share, "5", "is not a percentage"),
        (Share, "101%", "is not between 0% and 100%"),
        (Share, -0.5, "is not between 0% and 100%"),
        (Share, math.nan, "is not between 0% and 100%"),
        (Share, True, "is not a percentage"),
        (Rate, "64", "is not a rate"),
        (Rate, "0B/s", "less than one byte per second"),
        (Rate, 64, "is not a rate"),
        (HresultQuantity, "E_FAL", "did you mean 'E_FAIL'"),
        (HresultQuantity, 1 << 32, "is not an HRESULT"),
        (HresultQuantity, -(2**31) - 1, "is not an HRESULT"),
        (HresultQuantity, 1 << 200, "a number of 201 bits is not an HRESULT"),
        (HresultQuantity, 1.5, "is not an HRESULT"),
        (FrameCondition, 5, "is not a filter"),
        (FrameCondition, "comand == 1", "did you mean 'command'"),
        (Span, "5", "is not a range"),
        (Span, "..", "is not a range"),
        (Span, "9..1", "the range '9..1' is empty"),
        (Span, "a..b", "is not a range"),
        (Span, "e..", "is not a range"),
        (Span, "0..1.1e19", "goes beyond ±1e+19"),
        (DurationQuantity, "x" * 1000, "…"),
    ],
)
def test_refusing(kind: Any, written: object, reason: str) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)):
        kind.read(written)


def test_a_condition_has_the_error_of_its_filter() -> None:
    with pytest.raises(FilterError):
        FrameCondition.read("comand == 1")
    assert FrameCondition.read(True).text == "true"


@pytest.mark.parametrize(
    ("path", "indexes"),
    [
        ("arg[0]", (0,)),
        ("arg[2][0]", (2, 0)),
        ("arg[65535][1][2]", (65535, 1, 2)),
        ("arg" + "[1]" * 8, (1,) * 8),
    ],
)
def test_a_path_is_read(path: str, indexes: tuple[int, ...]) -> None:
    assert read_path(path) == indexes


@pytest.mark.parametrize("path", ["arg", "arg[]", "arg[-1]", "arg[1", "x[1]", "arg[1]x", "arg" + "[1]" * 9])
def test_what_is_no_path_is_refused(path: str) -> None:
    with pytest.raises(ValueError, match="is not an argument such as"):
        read_path(path)


def test_an_error_shows_the_first_sixty_characters_of_a_text() -> None:
    with pytest.raises(ValueError, match=f"^'{'x' * 59}… is not an argument"):
        read_path("x" * 100)


def test_a_span_holds_numbers_back_and_what_is_no_number_too() -> None:
    span = Span.read("-90..90")
    assert [span.clamp(number) for number in (-91, -90, 0, 90.5, math.inf)] == [-90, -90, 0, 90, 90]
    assert span.clamp(math.nan) == -90
    assert Span.read("..5").clamp(math.nan) == 5
    assert Span.read("5..").clamp(-math.inf) == 5


@pytest.mark.parametrize(
    ("kind", "written", "other"),
    [(Span, "-90..90", "-90..91"), (FrameCondition, "serial == 1", "serial == 2")],
)
def test_values_are_equal_if_they_say_the_same(kind: Any, written: str, other: str) -> None:
    assert len({kind.read(written), kind.read(written)}) == 1
    assert kind.read(written) not in (kind.read(other), written)


@pytest.mark.parametrize(
    ("kind", "written", "text"),
    [
        (DurationQuantity, "1.5s", "1500ms"),
        (Share, 0.125, "12.5%"),
        (Rate, "125kB/s", "1Mbit/s"),
        (Rate, "125B/s", "1kbit/s"),
        (Rate, "100B/s", "800bit/s"),
        (HresultQuantity, "0x80004005", "E_FAIL"),
        (HresultQuantity, 5, "0x00000005"),
        (Span, "-90.0..", "-90.."),
    ],
)
def test_values_are_written_in_the_shortest_form(kind: Any, written: object, text: str) -> None:
    assert kind.read(written).text == text


@given(st.integers(0, 10**9 * 86_400 * 365))
def test_durations_are_written_back(value: int) -> None:
    assert DurationQuantity.read(DurationQuantity(value).text) == value


@given(st.floats(0, 1))
def test_shares_are_written_back(value: float) -> None:
    assert math.isclose(Share.read(Share(value).text), value, abs_tol=1e-15)


@given(st.integers(0, 0xFFFFFFFF))
def test_codes_are_written_back(value: int) -> None:
    assert HresultQuantity.read(HresultQuantity(value).text) == value


@given(st.integers(8, 10**12))
def test_rates_are_written_back(bits: int) -> None:
    rate = Rate(bits / 8)
    assert Rate.read(rate.text) == rate


@given(st.floats(-1e9, 1e9), st.floats(0, 1e9), st.sampled_from(["both", "low", "high"]))
def test_spans_are_written_back(low: float, width: float, ends: str) -> None:
    span = Span(-math.inf if ends == "high" else low, math.inf if ends == "low" else low + width)
    assert Span.read(span.text) == span
