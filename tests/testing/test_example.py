"""The example of the page "Test your own client": the report of the plugin names the planted bug."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_TIME = re.compile(r"\d+\.\d+ s")
_EXAMPLE = _ROOT / "examples" / "test_my_client"


def _run_example(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the tests of the example outside of the project, as a user does."""
    argv = [sys.executable, "-P", "-m", "pytest", "-p", "no:cacheprovider", "--strict-markers", str(folder)]
    return subprocess.run(argv, cwd=folder, capture_output=True, text=True, check=False)


def _copy_example(tmp_path: Path) -> Path:
    return shutil.copytree(_EXAMPLE, tmp_path / "example", ignore=shutil.ignore_patterns("__pycache__"))


def test_the_report_names_the_planted_bug(tmp_path: Path) -> None:
    done = _run_example(_copy_example(tmp_path))
    assert done.returncode == 1, done.stdout + done.stderr
    assert "1 failed, 1 passed" in done.stdout
    assert "b-CAP: bcap_simulator" in done.stdout
    assert "error wrong-reserved" in done.stdout
    assert "its reserved field is 1 instead\n  of 3" in done.stdout


def test_the_corrected_client_passes(tmp_path: Path) -> None:
    folder = _copy_example(tmp_path)
    client = folder / "my_client.py"
    broken = client.read_text(encoding="utf-8")
    page = (_ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    (diff,) = re.findall(r"(?ms)^```diff\n(.*?)^```$", page)
    wrong, right = re.findall(r"(?m)^[-+](.*)$", diff)
    assert wrong in broken
    client.write_text(broken.replace(wrong, right), encoding="utf-8")
    done = _run_example(folder)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_page_shows_the_report(tmp_path: Path) -> None:
    page = (_ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"(?ms)^```text\n(.*?)^```$", page)
    output = _run_example(_copy_example(tmp_path)).stdout
    assert _TIME.sub("N", shown) in _TIME.sub("N", output)


def test_the_example_is_typed(tmp_path: Path) -> None:
    argv = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "."]
    done = subprocess.run(argv, cwd=_copy_example(tmp_path), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
