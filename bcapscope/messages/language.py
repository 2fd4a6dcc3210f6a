"""Languages of the reader."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Language(StrEnum):
    """A language that the catalogue has."""

    ENGLISH = "en"
    JAPANESE = "ja"


def language_of(environment: Mapping[str, str]) -> Language:
    """Choose the language as POSIX does: LC_ALL before LC_MESSAGES before LANG; English if none is known."""
    names = (environment.get(name, "") for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    name = next(filter(None, names), "")
    return Language.JAPANESE if name.casefold().startswith("ja") else Language.ENGLISH
