"""Matches: what a filter asks of one value."""

from __future__ import annotations

import ipaddress
import math

import pytest

from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.traffic.filter import matching as matches
from bcapscope.traffic.observation import Endpoint

V4 = ipaddress.ip_address("10.0.0.2")
V6 = ipaddress.ip_address("fe80::1")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("10.0.0.2", (V4, None)),
        ("10.0.0.2:5007", (V4, 5007)),
        ("fe80::1", (V6, None)),
        ("[fe80::1]", (V6, None)),
        ("[FE80:0::1]:0", (V6, 0)),
        (Endpoint("10.0.0.2", 5007), (V4, 5007)),
        (Endpoint("fe80::1", 5007), (V6, 5007)),
        ("", None),
        ("COM1", None),
        ("10.0.0.2:", (V4, None)),
        ("10.0.0.2:65536", None),
        ("10.0.0.2:٣", None),
        ("10.0.0.2:-1", None),
        ("[fe80::1", None),
        ("[fe80::1]5007", None),
        ("[]", None),
        ("1" * 10_000, None),
        (f"fe80::1%{'x' * 120}", (ipaddress.ip_address(f"fe80::1%{'x' * 120}"), None)),
        (f"fe80::1%{'x' * 121}", None),
        (Endpoint("x\ud800", -5), None),
    ],
)
def test_parse_endpoint(text: str | Endpoint, expected: object) -> None:
    assert matches.parse_endpoint(text) == expected


def test_elements_are_plain() -> None:
    inner = Variant.array(VT.VARIANT, (Variant(VT.I4, 5), Variant(VT.VARIANT, Variant(VT.I4, 6))))
    argument = Argument(inner, 15, 40)
    assert [matches.element(argument, index) for index in range(3)] == [5, 6, None]
    assert matches.element((argument,), 0) == inner.value
    assert matches.element(b"\x07", 0) == 7
    assert matches.element([1, 2], 1) == 2
    for no_list in ("text", None, 5, Endpoint("10.0.0.2", 5007), Variant(VT.I4, 5)):
        assert matches.elements(no_list) == ()


@pytest.mark.parametrize("value", [True, False, None, "5", b"5", (5,), math.nan])
def test_what_is_not_that_number(value: object) -> None:
    five = matches.number(5)
    assert not five(value)
    assert not matches.order("<", 5)(value)
    assert not matches.order(">=", 5)(value)
    assert (five(value) is not None) is isinstance(value, float)


def test_codes_are_equal_however_signed() -> None:
    wanted = matches.code(-2147024890)
    assert wanted(0x80070006)
    assert wanted(-2147024890)
    assert not wanted(6)
    assert not wanted(2147942406.0)
    assert not matches.code(1)(True)
    assert matches.code_order("<", 0, True)(0x80070006)
    assert not matches.code_order("<", 0, False)(0x80070006)
    assert matches.code_order(">", 0, True)(1)
    assert matches.code_order(">", 0, False)(1)


def test_an_address_of_either_leg_matches() -> None:
    legs = (Endpoint("10.0.0.1", 5007), Endpoint("10.0.0.2", 5008))
    assert matches.endpoint(V4, 5008)(legs) is True
    assert matches.endpoint(V4, 5007)(legs) is False


def test_text_is_compared_without_regard_to_case() -> None:
    assert matches.text("Straße")("STRASSE")
    assert matches.contains("SLV")("xslvMove")
    assert matches.search("ÄRM$")("der ärm")
    assert not matches.search("(?-i)ÄRM$")("der ärm")


@pytest.mark.parametrize(
    ("wanted", "value", "has"),
    [
        (3, b"\x01\x03", True),
        (3.0, b"\x01\x03", True),
        (0, b"\x00", True),
        (255, b"\xff", True),
        (3.5, b"\x01\x03", False),
        (256, b"\x00\xff", False),
        (-1, b"\xff", False),
        (1, (True, False), False),
        (0, (True, False), False),
        (90.5, (1.0, 90.5), True),
        (5, (1.0, 5.0), True),
        (5, (), False),
        (5, ("5",), False),
        (5, (Variant(VT.BOOL, True), Variant(VT.R8, 5.0)), True),
        (1, (Variant(VT.BOOL, True), Variant(VT.BSTR, "1")), False),
        (5, Variant(VT.I4 | ARRAY, (4, 5), 2), True),
        (5, 5, False),
        (5, None, False),
    ],
)
def test_a_list_contains_a_number(wanted: float, value: object, has: bool) -> None:
    assert matches.contains(wanted)(value) is has


def test_search_takes_any_text() -> None:
    found = matches.search("^.*b$")
    assert found("a" * 500 + "b")
    assert found("b")
    assert not found("\ud800" * 300)
    assert not found("b\n")
    assert matches.search("b")("\ud800b\x00")
    assert matches.search("\ud800")("a\ud800")
    assert matches.search("10.0.0.2:5")(Endpoint("10.0.0.2", 5007))
    assert not matches.search("5")(5)
    assert not matches.search("5")(b"5")


@pytest.mark.parametrize("pattern", ["(", "a**", r"\1", "(?=a)", "[z-a]", "((a{900}){900}){900}"])
def test_what_re2_does_not_take_is_a_value_error(pattern: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match=r"\w") as caught:
        matches.search(pattern)
    reason, part = caught.value.args
    assert reason
    assert isinstance(part, str)
    assert capfd.readouterr() == ("", "")
