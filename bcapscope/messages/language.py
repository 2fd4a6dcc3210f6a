"""Languages of the reader."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Language(StrEnum):
    """A language of the message catalogue."""

    ENGLISH = "en"
    JAPANESE = "ja"


def language_of(environment: Mapping[str, str]) -> Language:
    """Choose the language by LC_ALL, LC_MESSAGES and LANG, in this order, as POSIX does; else English."""
    names = (environment.get(name, "") for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    name = next(filter(None, names), "")
    return Language.JAPANESE if name.casefold().startswith("ja") else Language.ENGLISH
