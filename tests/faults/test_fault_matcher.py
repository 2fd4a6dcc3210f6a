"""Which messages a fault hits by chance."""

from __future__ import annotations

import pytest

from bcapscope.faults.fault_matcher import FaultMatcher
from bcapscope.faults.fault_notation import read_fault


@pytest.mark.parametrize(("text", "draws"), [("drop", False), ("drop 99%", True), ("drop 0%", True)])
def test_only_a_fault_that_may_miss_draws_a_random_number(text: str, draws: bool) -> None:
    matcher = FaultMatcher(read_fault(text), "mine", seed=1, now=0)
    before = matcher.rng.getstate()
    matcher.draw()
    assert (matcher.rng.getstate() != before) is draws
