"""The language of what is rendered: English, unless whoever asks for it has another tongue."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

Tongue: TypeAlias = Callable[[str], str]
"""Puts an English phrase into the reader's language; what it does not know stays as it is."""


def english(phrase: str) -> str:
    """Say it as it is."""
    return phrase
