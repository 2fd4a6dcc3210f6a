"""A small version of the attack on the served screen."""

from __future__ import annotations

import sys

import pytest

pytest.importorskip("textual_serve")

from tests.security.origins import foreign_origins


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_foreign_origins_are_refused_and_hold_nobody_up() -> None:
    outcome = foreign_origins(requests=60, silent=100, seconds=1.0)
    assert set(outcome.halt) == {"tcp", "udp", "browser"}
