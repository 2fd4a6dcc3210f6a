"""The names of `bcapscope` itself: they are complete, and load nothing before they are used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import bcapscope


@pytest.mark.parametrize("name", bcapscope.__all__)
def test_every_name_can_be_imported(name: str) -> None:
    assert name in dir(bcapscope)
    assert getattr(bcapscope, name).__doc__


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="simulater"):
        _ = bcapscope.simulater


@pytest.mark.parametrize("name", ["__version__", *bcapscope.__all__])
def test_a_name_loads_nothing_heavy(name: str) -> None:
    program = "import bcapscope, sys; getattr(bcapscope, sys.argv[1]); print(*sys.modules)"
    argv = [sys.executable, "-c", program, name]
    loaded = subprocess.run(argv, capture_output=True, text=True, check=True).stdout.split()
    heavy = {"numpy", "scapy", "textual", "asyncio"} - ({"asyncio"} if name == "connect" else set())
    assert not heavy & set(loaded)
