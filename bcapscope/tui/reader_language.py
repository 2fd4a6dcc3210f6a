"""Language of the screen, and its labels in that language.

The catalogue holds the labels; their ids begin with the name of a screen or widget, such as `shell.quit`.
"""

from __future__ import annotations

import os
from functools import lru_cache

from bcapscope.errors import BcapError
from bcapscope.messages import Language, Message, MessageFormatter, language_of
from bcapscope.messages.message import PlaceValue, has_message
from bcapscope.protocol.tables.table_text import table_message
from bcapscope.tui.words.phrases import Phrasebook

_CACHED = 1000
"""Sentences whose Japanese is cached: the same ones are drawn again and again."""


class _Reader:
    words = MessageFormatter(language_of(os.environ))


def set_language(language: Language) -> None:
    """Choose the language of everything that this process shows from now on."""
    _Reader.words = MessageFormatter(language)


def current_language() -> Language:
    """Return the language of this process's screen."""
    return _Reader.words.language


def reader_words() -> MessageFormatter:
    """Return the formatter in the language of the screen."""
    return _Reader.words


def label(id: str, /, **places: PlaceValue) -> str:
    """Return a text of the screen. Strings in `places` are escaped already."""
    return _Reader.words(id, **places)


def localized(sentence: Message | str | Exception) -> str:
    """Return a sentence in the language of the screen; a string without a known translation is unchanged."""
    message = sentence.message if isinstance(sentence, BcapError) else sentence
    if isinstance(message, Message) and has_message(message.id):
        return _Reader.words.text(message)
    return _japanese(str(message)) if _Reader.words.language is Language.JAPANESE else str(message)


def table_text(english: str) -> str:
    """Return a text of the protocol's tables in the language of the screen."""
    return _Reader.words.text(table_message(english))


@lru_cache(1)
def _phrasebook() -> Phrasebook:
    from bcapscope.tui.words import PHRASES  # noqa: PLC0415 - takes as long to load as a screen

    return Phrasebook(PHRASES)


@lru_cache(_CACHED)
def _japanese(sentence: str) -> str:
    return _phrasebook().japanese(sentence)
