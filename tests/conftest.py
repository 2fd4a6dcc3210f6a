"""What all tests share: settings of hypothesis, golden files, a check that no test changes the next one.

``pytest --hypothesis-profile=deep`` tries thirty times as much, ``pytest --golden-write`` writes the golden
files anew.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, settings

from tests.leftovers import nothing_left

# A busy machine is no failure: pytest's own time-out bounds a test.
settings.register_profile(
    "fast", max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("deep", settings.get_profile("fast"), max_examples=2000)
settings.load_profile("fast")

# The action log of what tests send is not the user's; programs that tests start inherit this.
_STATE = TemporaryDirectory(prefix="bcapscope-tests-", ignore_cleanup_errors=True)
os.environ["XDG_STATE_HOME"] = _STATE.name
# Users do not set this variable; it hides output that Python cannot write at exit.
os.environ.pop("PYTHONUNBUFFERED", None)

_GOLDEN = Path(__file__).parent / "golden"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--golden-write", action="store_true", help="write golden files instead of comparing")


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    """Fail a test that leaves the process changed."""
    with nothing_left():
        yield


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Callable[[str, bytes], None]:
    """Compare output with the file of that name in tests/golden, byte for byte."""

    def compare(name: str, output: bytes) -> None:
        path = _GOLDEN / name
        if request.config.getoption("--golden-write"):
            path.write_bytes(output)
        assert output.decode() == path.read_bytes().decode()
        assert output == path.read_bytes()

    return compare
