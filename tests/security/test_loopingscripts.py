"""A small version of the attack by the user's own script."""

from __future__ import annotations

import sys

import pytest

from tests.security.loopingscripts import looping_script


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("name", ["loop", "stops"])
def test_a_script_does_not_stop_the_relay(name: str) -> None:
    outcome = looping_script(name, seconds=1.0)
    assert set(outcome.halt) == {"tcp", "udp"}
