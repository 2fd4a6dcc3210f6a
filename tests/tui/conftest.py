"""No test of the screen uses the settings of the user who runs it, or leaves another language."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bcapscope.messages import Language
from bcapscope.tui.reader_language import set_language


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep settings in the folder of the test."""
    monkeypatch.setattr(
        "bcapscope.tui.app.default_settings_path", lambda: tmp_path / "own-settings" / "screen.yaml"
    )


@pytest.fixture(autouse=True)
def _english() -> Iterator[None]:
    """Begin and end in English, whatever language a test sets."""
    set_language(Language.ENGLISH)
    yield
    set_language(Language.ENGLISH)


@pytest.fixture
def japanese_screen(_english: None) -> None:
    """Show labels in Japanese."""
    set_language(Language.JAPANESE)
