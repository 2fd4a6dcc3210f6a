"""The captures that ship with the project are what the script makes, nothing more and nothing less."""

from pathlib import Path

import pytest

from tests.samples.catalogue import files

FOLDER = Path(__file__).parents[1] / "captures"
MADE = files()


def test_nothing_else_is_there() -> None:
    assert {path.name for path in FOLDER.iterdir()} == MADE.keys()


@pytest.mark.parametrize("name", MADE)
def test_bytes_are_those_of_the_script(name: str) -> None:
    assert (FOLDER / name).read_bytes() == MADE[name], "run python -m tests.samples"


@pytest.mark.parametrize("name", MADE)
def test_is_small(name: str) -> None:
    assert len(MADE[name]) < 100_000
