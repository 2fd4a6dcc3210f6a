"""The notebook runs, prints what is stored in it, and has sound types."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.user_types import reported_by_mypy

PATH = Path(__file__).parents[2] / "examples" / "joints.ipynb"
CELLS: list[dict[str, Any]] = json.loads(PATH.read_text("utf-8"))["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]
PROGRAM = "\n\n".join("".join(cell["source"]) for cell in CODE)
LARGEST = 200_000
"""Bytes; the repository keeps each version of the stored picture."""


def test_it_has_ten_cells_and_a_stored_picture() -> None:
    assert len(CELLS) == 10
    assert PATH.stat().st_size < LARGEST
    outputs = [output for cell in CODE for output in cell["outputs"]]
    assert "error" not in {output["output_type"] for output in outputs}
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 1
    assert all(cell["metadata"] == {} for cell in CELLS)


def test_the_cells_print_what_is_stored_and_do_not_load_scapy() -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("pandas")
    program = f"{PROGRAM}\nimport sys; assert 'scapy' not in sys.modules"
    argv = [sys.executable, "-X", "utf8", "-W", "error", "-W", "ignore:FigureCanvasAgg", "-c", program]
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run(
        argv, cwd=PATH.parent, env=environment, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr
    stored = [output for cell in CODE for output in cell["outputs"] if output["output_type"] == "stream"]
    assert done.stdout == "".join("".join(output["text"]) for output in stored)


def test_the_cells_have_sound_types(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / "notebook.py"
    path.write_text(PROGRAM, "utf-8")
    assert reported_by_mypy(path) == []
