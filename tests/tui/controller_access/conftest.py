"""A simulator in a process of its own for all tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bcapscope.tui.controller_access.builtin_simulator import BuiltInSimulator, run_builtin_simulator


@pytest.fixture(scope="module")
def simulator() -> Iterator[BuiltInSimulator]:
    """Run the built-in simulator."""
    with run_builtin_simulator("rc7") as place:
        yield place
