"""The Option field of the connection."""

from __future__ import annotations

import pytest

from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.tui.controller_access.option_field import AUTOMATIC_PROVIDERS, read_option_field


def test_the_option_of_the_tester() -> None:
    target, providers = read_option_field("Timeout=300", "10.6.235.60", 5007, False)
    assert (target.host, target.timeout, target.tcp, target.service) == ("10.6.235.60", 300.0, False, "")
    assert providers == AUTOMATIC_PROVIDERS


def test_each_key_goes_where_it_belongs() -> None:
    text = "Timeout=500, retry=2, WDT=400,InvokeTimeout=1000, Provider=X, Machine=m, Name=n, @IfNotMember"
    text += ", Reserved=OWN"
    target, providers = read_option_field(text, "h", 1, False)
    assert (target.timeout, target.retries) == (500.0, 2)
    assert target.service == ",WDT=400,InvokeTimeout=1000"
    assert target.connect == ("n", "X", "m", "@IfNotMember")
    assert target.convention is ReservedConvention.OWN
    assert providers == ("X",)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("Timeout", "key=value"),
        ("Timeout=x", "1 to 600000"),
        ("Timeout=0", "1 to 600000"),
        ("WDT=5", "80 to"),
        ("Reserved=tcp0", "seed, own, chain"),
        ("Speed=3", "Speed: unknown key"),
        ("=", ": unknown key"),
        ("Timeout=³", "1 to 600000"),
    ],
)
def test_what_makes_no_sense_is_told(text: str, part: str) -> None:
    with pytest.raises(ValueError, match=part):
        read_option_field(text, "h", 1, False)
