"""Right sides of comparisons: what a literal means to a field of each type."""

from __future__ import annotations

from fractions import Fraction

import pytest

from bcapscope.traffic.filter import operands
from bcapscope.traffic.filter.field_table import FIELD_BY_NAME, FieldType, FilterField, RecordKind
from bcapscope.traffic.filter.matching import Match
from bcapscope.traffic.filter.operands import ComparedField
from bcapscope.traffic.filter.tokens import FilterError, tokenize


def equal_to(name: str, literal: str) -> Match:
    field = FIELD_BY_NAME[name]
    subject = ComparedField(f"{name} == {literal}", field, name, field.type, 0)
    return operands.equality(subject, [tokenize(subject.expression)[2]], negated=False)


@pytest.mark.parametrize(
    ("name", "literal", "value"),
    [
        ("serial", "0x10", 16),
        ("serial", "+7", 7),
        ("serial", "-0x10", -16),
        ("serial", "1e3", 1000),
        ("latency", "1ns", 1),
        ("latency", "1us", 1_000),
        ("latency", "1.5µs", 1_500),
        ("latency", "0.3ms", 300_000),
        ("latency", "0x2 ms", 2_000_000),
        ("latency", "0.000000001s", 1),
        ("latency", "0", 0),
        ("latency", "0.1ns", Fraction(1, 10)),
        ("latency_ms", "0.1", 100_000),
        ("time", "1700000000.123456789", 1_700_000_000_123_456_789),
        ("time", "'1970-01-01'", 0),
        ("time", "'1970-01-01 00:01'", 60 * 10**9),
        ("time", "'1970-01-01T09:00:00+09:00'", 0),
        ("time", "'1969-12-31 23:59:59.999999999Z'", -1),
        ("hresult", "s_ok", 0),
        ("hresult", '"E_HANDLE"', 0x80070006),
        ("hresult", "-1", 0xFFFFFFFF),
        ("hresult", "0xFFFFFFFF", -1),
    ],
)
def test_means_exactly_that_value(name: str, literal: str, value: object) -> None:
    assert equal_to(name, literal)(value) is True


@pytest.mark.parametrize(
    ("name", "literal", "position"),
    [("latency", "1min", 12), ("latency", "15min", 13), ("latency", "5", 11)],
)
def test_the_error_of_a_duration_is_at_its_unit(name: str, literal: str, position: int) -> None:
    with pytest.raises(FilterError) as caught:
        equal_to(name, literal)
    assert caught.value.position == position


@pytest.mark.parametrize(("count", "is_listed"), [(5, True), (6, False)])
def test_an_error_lists_a_few_possible_words(count: int, is_listed: bool) -> None:
    words = ("alpha", "beta", "gamma", "delta", "epsilon", "zeta")[:count]
    field = FilterField("letter", FieldType.TEXT, (RecordKind.FRAME,), "a letter", values=words)
    subject = ComparedField("letter == xyz", field, "letter", field.type, 0)
    with pytest.raises(FilterError) as caught:
        operands.equality(subject, [tokenize(subject.expression)[2]], negated=False)
    assert (", ".join(words) in str(caught.value.reason)) is is_listed


@pytest.mark.parametrize("name", ["latency", "serial", "hresult", "serials"])
def test_numbers_cannot_be_searched(name: str) -> None:
    field = FIELD_BY_NAME[name]
    subject = ComparedField(f"{name} ~ 'text'", field, name, field.type, 0)
    with pytest.raises(FilterError, match="text"):
        operands.search(subject, tokenize(subject.expression)[2])


@pytest.mark.parametrize(
    ("name", "literal"),
    [
        ("time", "'0001-13-01'"),
        ("time", "'2024-05-01 25:00'"),
        ("time", "'2024-05-01 12:00+99:99'"),
        ("time", "'2024-05-01 12:00:00.1234567890'"),
        ("latency", "1min"),
        ("latency", "'5ms'"),
        ("latency", "fast"),
        ("hresult", "0x1ms"),
        ("hresult", "10.0.0.1"),
    ],
)
def test_refuses_what_means_nothing(name: str, literal: str) -> None:
    with pytest.raises(FilterError):
        equal_to(name, literal)
