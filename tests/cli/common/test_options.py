"""Options that several commands share."""

from __future__ import annotations

import click
import pytest

from bcapscope.cli.common.options import NumberRange


@pytest.mark.parametrize("text", ["nan", "-nan", "inf", "-inf", "1e400", "1e20", "-1", "0.4", "", "5 s"])
def test_what_is_no_number_within_bounds_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        NumberRange(0.5).convert(text, None, None)


@pytest.mark.parametrize(("text", "number"), [("0.5", 0.5), ("1e6", 1_000_000.0), ("8", 8.0)])
def test_numbers_within_bounds(text: str, number: float) -> None:
    assert NumberRange(0.5).convert(text, None, None) == number
    assert NumberRange(0.5, 10_000_000).convert(text, None, None) == number
