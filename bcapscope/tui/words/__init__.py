"""Everything that the screen says, in English and Japanese.

Labels have a key, with the name of their screen or widget before the point: ``say("shell.quit")``. One module
a screen holds the pairs; nothing is written in place. Sentences that come ready from rooms below, which know
English only, are put into Japanese by `told`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType

from bcapscope.render.tongue import Tongue, english
from bcapscope.tui.words import (
    calls,
    commands,
    desk,
    figures,
    files,
    findings,
    frames,
    meanings,
    preflight,
    proxy,
    reading,
    reasons,
    relay,
    remarks,
    results,
    rules,
    shell,
    tester,
    traffic,
    widgets,
)
from bcapscope.tui.words.phrases import Phrasebook

CATALOGUE: Mapping[str, tuple[str, str]] = MappingProxyType(
    {**desk.WORDS, **proxy.WORDS, **shell.WORDS, **tester.WORDS, **traffic.WORDS, **widgets.WORDS}
)
"""English and Japanese by key. Braces hold places for values, as in `str.format`."""

_BOOKS = (
    calls,
    commands,
    figures,
    files,
    findings,
    frames,
    meanings,
    preflight,
    reading,
    reasons,
    relay,
    remarks,
    results,
    rules,
)

PHRASES: Mapping[str, str] = MappingProxyType(
    {sentence: japanese for book in _BOOKS for sentence, japanese in book.PHRASES.items()}
)
"""Japanese by English, as `Phrasebook` takes it."""

_KEPT = 1000
"""Sentences in Japanese that are kept: the same ones are drawn again and again."""


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


def spoken() -> Language:
    """Return the language of all that is said."""
    return _Speaker.language


def say(key: str, /, **values: object) -> str:
    """Return a label; `values` fill its places and are harmless already.

    Raises:
        KeyError: there is no such key.
    """
    ours, japanese = CATALOGUE[key]
    text = japanese if _Speaker.language is Language.JAPANESE else ours
    return text.format(**values) if values else text


def told(sentence: str) -> str:
    """Return a sentence of a room below in the language of the labels; as it is where that is not known."""
    return tongue(_Speaker.language)(sentence)


def tongue(language: Language) -> Tongue:
    """Return what puts sentences of rooms below into a language."""
    return _japanese if language is Language.JAPANESE else english


def titled(rule: str) -> str:
    """Return the title of a rule by its id, which is its name in English."""
    return rules.TITLES.get(rule, rule) if _Speaker.language is Language.JAPANESE else rule


@lru_cache(1)
def _phrasebook() -> Phrasebook:
    return Phrasebook(PHRASES)  # made when it is needed: that takes as long as many a screen


@lru_cache(_KEPT)
def _japanese(sentence: str) -> str:
    return _phrasebook().japanese(sentence)
