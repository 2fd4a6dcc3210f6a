"""The bytes that buffers hold together."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.byte_budget import ByteBudget


@pytest.mark.parametrize(("held", "is_exceeded"), [(32 * 2**20, False), (32 * 2**20 + 1, True)])
def test_two_frames_of_16_mib_are_held_and_no_more(held: int, is_exceeded: bool) -> None:
    budget = ByteBudget()
    budget.held = held
    assert budget.is_exceeded is is_exceeded
