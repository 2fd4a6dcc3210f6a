"""The examples of docs/python.md run, print what the page shows, and have sound types."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.user_types import reported_by_mypy

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / "python.md").read_text("utf-8")
EXAMPLES = re.findall(r"(?ms)^```python\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?", PAGE)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 3


@pytest.mark.parametrize(("program", "output"), EXAMPLES)
def test_every_example_prints_what_the_page_shows(program: str, output: str) -> None:
    if "to_pandas" in program:
        pytest.importorskip("pandas")
    argv = [sys.executable, "-X", "dev", "-X", "utf8", "-W", "error", "-c", program]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == output


def test_every_example_has_sound_types(tmp_path: Path) -> None:
    paths = [tmp_path / f"example_{number}.py" for number in range(len(EXAMPLES))]
    for path, (program, _) in zip(paths, EXAMPLES, strict=True):
        path.write_text(program, "utf-8")
    assert reported_by_mypy(*paths) == []


def test_types_of_users_are_reported_by_mypy(tmp_path: Path) -> None:
    path = tmp_path / "wrong.py"
    path.write_text("import bcapscope\nbcapscope.open(5)\nbcapscope.Packet\n", "utf-8")
    assert [line.rpartition("[")[2] for line in reported_by_mypy(path)] == ["arg-type]", "attr-defined]"]
