"""Check the types of programs as users write them: strictly, without the project's settings of mypy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).parent.parent


def reported_by_mypy(*paths: Path) -> list[str]:
    """Return what mypy reports about programs; skip the test if mypy is not installed."""
    pytest.importorskip("mypy")
    argv = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary"]
    # as for an installed package, even in a checkout that is not installed
    argv += ["--follow-imports", "silent"]
    argv += ["--config-file", "", "--cache-dir", str(_ROOT / ".mypy_cache" / "examples")]
    argv += map(str, paths)
    done = subprocess.run(argv, cwd=_ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout.splitlines()
