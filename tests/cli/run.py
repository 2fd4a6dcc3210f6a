"""Running the program as a user does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

CAPTURES = Path(__file__).parent.parent.parent / "captures"


class Ran(NamedTuple):
    """What came of it."""

    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """What stands on stdout, by lines."""
        return self.out.splitlines()


def run(*words: str | Path, stdin: bytes = b"", **environment: str) -> Ran:
    """Run ``bcapscope`` with `words`."""
    argv = [sys.executable, "-m", "bcapscope", *map(str, words)]
    env = {**os.environ, "NO_COLOR": "", **environment}
    done = subprocess.run(argv, input=stdin, capture_output=True, check=False, env=env)
    return Ran(done.returncode, done.stdout.decode(), done.stderr.decode())
