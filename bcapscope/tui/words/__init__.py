"""Japanese for the English sentences that other packages still make."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bcapscope.tui.words import (
    figures,
    files,
    frames,
    preflight,
    reading,
    reasons,
    relay,
    remarks,
    results,
)

_BOOKS = (
    figures,
    files,
    frames,
    preflight,
    reading,
    reasons,
    relay,
    remarks,
    results,
)

PHRASES: Mapping[str, str] = MappingProxyType(
    {sentence: japanese for book in _BOOKS for sentence, japanese in book.PHRASES.items()}
)
"""Japanese by English, as `Phrasebook` takes it."""
