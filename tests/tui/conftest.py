"""No test of the screen reads or writes the settings of whoever runs it."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep settings in the folder of the test."""
    monkeypatch.setattr("bcapscope.tui.app.default_path", lambda: tmp_path / "own-settings" / "screen.yaml")
