"""The page of limits states the values of the code."""

from __future__ import annotations

from decimal import Decimal

import pytest

from tests.documented_limits import documented_limits, value_in_code


@pytest.mark.parametrize(("name", "documented"), documented_limits("faults"))
def test_the_documented_limit_is_the_limit(name: str, documented: Decimal) -> None:
    assert value_in_code(name) == float(documented)
