"""Every label of the screen in English and Japanese, by a key.

One module a screen holds the pairs; nothing is written in place. Keys have the name of their screen or
widget before the point: ``say("shell.quit")``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from bcapscope.tui.words import proxy, shell, tester, traffic, widgets

CATALOGUE: Mapping[str, tuple[str, str]] = MappingProxyType(
    {**proxy.WORDS, **shell.WORDS, **tester.WORDS, **traffic.WORDS, **widgets.WORDS}
)
"""English and Japanese by key. Braces hold places for values, as in `str.format`."""


class Language(StrEnum):
    """What the labels are written in."""

    ENGLISH = "en"
    JAPANESE = "ja"


def language_of(environment: Mapping[str, str]) -> Language:
    """Choose the language as POSIX has it: LC_ALL before LC_MESSAGES before LANG."""
    names = (environment.get(name, "") for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    name = next(filter(None, names), "")
    return Language.JAPANESE if name.casefold().startswith("ja") else Language.ENGLISH


class _Speaker:
    language = language_of(os.environ)


def speak(language: Language) -> None:
    """Choose the language of all that is said from now on."""
    _Speaker.language = language


def say(key: str, **values: object) -> str:
    """Return a label; `values` fill its places and are harmless already.

    Raises:
        KeyError: there is no such key.
    """
    english, japanese = CATALOGUE[key]
    text = japanese if _Speaker.language is Language.JAPANESE else english
    return text.format(**values) if values else text
