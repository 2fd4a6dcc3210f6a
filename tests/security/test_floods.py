"""Small versions of the floods."""

from __future__ import annotations

import pytest

from tests.security import floods

pytestmark = pytest.mark.deep


@pytest.mark.parametrize("name", floods.names())
def test_a_flood_is_survived(name: str) -> None:
    floods.attack(name, seconds=0.5, clients=2)
