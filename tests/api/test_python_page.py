"""The examples of docs/python.md run, print what the page shows, and have sound types."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

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


def checked(*paths: Path) -> list[str]:
    """Return what mypy reports about programs of users."""
    pytest.importorskip("mypy")
    argv = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary"]
    argv += ["--config-file", "", "--cache-dir", str(ROOT / ".mypy_cache" / "examples")]
    argv += map(str, paths)
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_every_example_has_sound_types(tmp_path: Path) -> None:
    paths = [tmp_path / f"example_{number}.py" for number in range(len(EXAMPLES))]
    for path, (program, _) in zip(paths, EXAMPLES, strict=True):
        path.write_text(program, "utf-8")
    assert checked(*paths) == []


def test_types_of_users_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "wrong.py"
    path.write_text("import bcapscope\nbcapscope.open(5)\nbcapscope.Packet\n", "utf-8")
    assert [line.rpartition("[")[2] for line in checked(path)] == ["arg-type]", "attr-defined]"]
