"""What starting the program really imports: the heavy libraries are for those who need them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bcapscope

HEAVY = {"numpy", "orjson", "rich", "scapy", "textual"}
SCAPY_USERS = {"bcapscope.capture.layer", "bcapscope.capture.live"}

# Imports every module named on the command line in turn and tells which was the first to bring scapy along.
_FIRST_WITH_SCAPY = """
import importlib, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
    if "scapy" in sys.modules:
        sys.exit(f"{name} imports scapy")
"""


def _modules() -> set[str]:
    """Return the full names of all modules of the package, the one that runs on import left out."""
    (root,) = bcapscope.__path__
    paths = (path.relative_to(Path(root).parent) for path in Path(root).rglob("*.py"))
    names = {".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in paths}
    return names - {"bcapscope.__main__"}


def _imported_by(*args: str) -> set[str]:
    """Return the top-level names of all modules imported while ``python -m bcapscope`` ran with `args`."""
    argv = [sys.executable, "-X", "importtime", "-m", "bcapscope", *args]
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in lines}


def test_help_imports_nothing_heavy() -> None:
    imported = _imported_by("--help")
    assert "bcapscope" in imported
    assert not imported & HEAVY


def test_version_imports_nothing_heavy() -> None:
    assert not _imported_by("--version") & HEAVY


def test_scapy_is_imported_only_by_the_modules_that_need_it() -> None:
    modules = _modules()
    assert "bcapscope.capture.source" in modules
    argv = [sys.executable, "-c", _FIRST_WITH_SCAPY, *sorted(modules - SCAPY_USERS)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
