"""The folder of recordings and documents that some tests read; a user's clone has none."""

from __future__ import annotations

from pathlib import Path

SHARED = Path(__file__).parents[2] / "shared"
