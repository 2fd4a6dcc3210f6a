"""Language of rendered text: English unless the caller passes another `Tongue`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

Tongue: TypeAlias = Callable[[str], str]
"""Puts an English phrase into the reader's language; what it does not know stays as it is."""


def english(phrase: str) -> str:
    """Say it as it is."""
    return phrase
