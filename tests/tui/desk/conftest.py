"""A simulator in a process of its own for all tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bcapscope.tui.desk.builtin import BuiltIn, builtin_simulator


@pytest.fixture(scope="module")
def simulator() -> Iterator[BuiltIn]:
    """Run the built-in simulator."""
    with builtin_simulator() as place:
        yield place
