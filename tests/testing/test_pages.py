"""The Python blocks of the documentation about tests of clients run as they are shown."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[2]
_BLOCKS = [
    pytest.param(block, id=f"{page}-{number}")
    for page in ("simulator.md",)
    for number, block in enumerate(
        re.findall(r"(?ms)^```python\n(.*?)^```$", (_ROOT / "docs" / page).read_text(encoding="utf-8"))
    )
]


@pytest.mark.parametrize("block", _BLOCKS)
def test_a_python_block_runs(block: str, tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, check=True)
