"""The dissector as a file, once per run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.wireshark.tshark import write_dissector


@pytest.fixture(scope="session")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of the dissector."""
    return write_dissector(tmp_path_factory.mktemp("dissector"))
