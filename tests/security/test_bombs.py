"""Small versions of the bombs, each read by one command."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import pytest

from tests.security import bombs
from tests.security.harness import MEMORY_LIMIT, run_measured

SCALE = 0.02
CASES = list(zip(bombs.bombs(SCALE), cycle(bombs.commands(Path(), Path())), strict=False))

pytestmark = pytest.mark.deep


@pytest.mark.parametrize(("bomb", "command"), CASES)
def test_a_bomb_is_read_in_bounded_memory(bomb: str, command: str, tmp_path: Path) -> None:
    path = tmp_path / "bomb.pcap.gz"
    bombs.write_apart(path, bomb, SCALE)
    ended = run_measured(bombs.commands(path, tmp_path)[command])
    assert ended.peak < MEMORY_LIMIT / 2
    assert ended.code in (0, 3, 5), ended.err
