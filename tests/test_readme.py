"""What the README shows is what is printed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def shown() -> list[tuple[str, str]]:
    """List each command line that the README shows with what it says that comes out of it."""
    blocks = re.findall(r"^```console\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
    runs = [run for block in blocks for run in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]]
    return [(command, output) for command, _, output in (run.partition("\n") for run in runs)]


@pytest.mark.parametrize(("command", "expected"), shown(), ids=lambda text: text[:60])
def test_every_sample_is_what_is_printed(command: str, expected: str, tmp_path: Path) -> None:
    program = tmp_path / "bcapscope"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m bcapscope "$@"\n')
    program.chmod(0o755)
    env = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["sh", "-c", command], cwd=ROOT, env=env, capture_output=True, check=False)
    assert done.stdout.decode() == expected


def test_there_are_samples() -> None:
    assert len(shown()) >= 4
