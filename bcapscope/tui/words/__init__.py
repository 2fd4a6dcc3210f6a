"""Everything that the screen says, in English and Japanese.

Labels have a key, with the name of their screen or widget before the point: ``say("shell.quit")``. One module
a screen holds the pairs; nothing is written in place. Sentences that come ready from rooms below, which know
English only, are put into Japanese by `told`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

from bcapscope.errors import BcapError
from bcapscope.messages import Language, MessageFormatter, language_of
from bcapscope.messages.message import PlaceValue
from bcapscope.protocol.tables.table_text import table_message
from bcapscope.render.tongue import Tongue, english
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
from bcapscope.tui.words.phrases import Phrasebook

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

_KEPT = 1000
"""Sentences in Japanese that are kept: the same ones are drawn again and again."""


class _Speaker:
    language = language_of(os.environ)


def speak(language: Language) -> None:
    """Choose the language of all that is said from now on."""
    _Speaker.language = language


def spoken() -> Language:
    """Return the language of all that is said."""
    return _Speaker.language


def say(key: str, /, **values: PlaceValue) -> str:
    """Return a label; `values` fill its places and are harmless already."""
    return reader_words()(key, **values)


def reader_words() -> MessageFormatter:
    """Return the formatter in the language of all that is said."""
    return MessageFormatter(_Speaker.language)


def error_words(error: Exception) -> str:
    """Return an error in the language of the labels, as far as it carries a message."""
    return reader_words().text(error.message) if isinstance(error, BcapError) else told(str(error))


def table_text(english: str) -> str:
    """Return a text of the protocol's tables."""
    return reader_words().text(table_message(english))


def told(sentence: str) -> str:
    """Return a sentence of a room below in the language of the labels; as it is where that is not known."""
    return tongue(_Speaker.language)(sentence)


def tongue(language: Language) -> Tongue:
    """Return what puts sentences of rooms below into a language."""
    return _japanese if language is Language.JAPANESE else english


def titled(rule: str) -> str:
    """Return the title of a rule by its id, which is its name in English."""
    return say(f"rule.{rule}.title") if _Speaker.language is Language.JAPANESE else rule


@lru_cache(1)
def _phrasebook() -> Phrasebook:
    return Phrasebook(PHRASES)  # made when it is needed: that takes as long as many a screen


@lru_cache(_KEPT)
def _japanese(sentence: str) -> str:
    return _phrasebook().japanese(sentence)
