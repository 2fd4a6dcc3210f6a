"""Small versions of the attack on `decode --text`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.security import hextext
from tests.security.harness import MEMORY_LIMIT

pytestmark = pytest.mark.deep


def test_texts_are_read_in_bounded_memory(tmp_path: Path) -> None:
    for what, ended in hextext.attack(tmp_path, hextext.MEGABYTE // 2):
        assert ended.peak < MEMORY_LIMIT / 3, what
