"""No test of the screen reads or writes the settings of the user who runs it, or leaves another language."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bcapscope.messages import Language
from bcapscope.tui.words import speak


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep settings in the folder of the test."""
    monkeypatch.setattr(
        "bcapscope.tui.app.default_settings_path", lambda: tmp_path / "own-settings" / "screen.yaml"
    )


@pytest.fixture(autouse=True)
def _english() -> Iterator[None]:
    """Begin and end in English, whatever language a test speaks."""
    speak(Language.ENGLISH)
    yield
    speak(Language.ENGLISH)


@pytest.fixture
def speaking_japanese(_english: None) -> None:
    """Speak Japanese."""
    speak(Language.JAPANESE)
