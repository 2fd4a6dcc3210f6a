"""Running the program as a user does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from click.testing import CliRunner

from bcapscope.cli import cli

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


def run_here(*words: str | Path) -> Ran:
    """Run ``bcapscope`` with `words` in this process, which takes a tenth of the time."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        done = CliRunner().invoke(cli, [str(word) for word in words])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return Ran(done.exit_code, done.stdout, done.stderr)
