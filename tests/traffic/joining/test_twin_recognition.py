"""Calls of one conversation inside the calls of another."""

from __future__ import annotations

import pytest

from bcapscope.traffic.joining.twin_recognition import NestedCalls, nested_calls
from bcapscope.traffic.observation import Observation
from tests.traffic.playbook import MOVE, MS, Script


def call(asked: float, replied: float) -> list[Observation]:
    client = Script().client()
    return [client.ask(asked, 1, 0, MOVE), client.reply(replied, 1)]


@pytest.mark.parametrize(
    ("inner", "contradicted"),
    [((1, 8), False), ((0, 9), False), ((-1 / MS, 8), True), ((1, 9 + 1 / MS), True)],
)
def test_a_call_is_nested_if_it_begins_no_earlier_and_ends_no_later(
    inner: tuple[float, float], contradicted: bool
) -> None:
    nested = nested_calls(call(0, 9), call(*inner))
    assert nested == NestedCalls(1, round(inner[0] * MS), contradicted)
    assert nested.proves_twins(1) is not contradicted
    assert not nested.proves_twins(2)
