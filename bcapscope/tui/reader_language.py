"""Language of the screen, and its labels in that language.

The catalogue holds the labels; their ids begin with the name of a screen or widget, such as `shell.quit`.
"""

from __future__ import annotations

import os

from bcapscope.errors import message_of
from bcapscope.messages import Language, MessageFormatter, language_of
from bcapscope.messages.message import PlaceValue
from bcapscope.protocol.tables.table_text import table_message


class _Reader:
    words = MessageFormatter(language_of(os.environ))
    is_fixed = False


def set_language(language: Language) -> None:
    """Choose the language of everything that this process shows from now on."""
    _Reader.words = MessageFormatter(language)


def fix_language(language: Language) -> None:
    """Choose the language as `set_language`; the settings do not change it."""
    set_language(language)
    _Reader.is_fixed = True


def apply_saved_language(name: str) -> None:
    """Choose the language of the settings, unless it is fixed; "" keeps that of the environment."""
    if name in tuple(Language) and not _Reader.is_fixed:
        set_language(Language(name))


def current_language() -> Language:
    """Return the language of this process's screen."""
    return _Reader.words.language


def reader_words() -> MessageFormatter:
    """Return the formatter in the language of the screen."""
    return _Reader.words


def label(id: str, /, **places: PlaceValue) -> str:
    """Return a text of the screen. Strings in `places` are escaped already."""
    return _Reader.words(id, **places)


def full_error_text(error: Exception) -> str:
    """Return what an exception says, in the language of the screen."""
    return _Reader.words.text(message_of(error))


def table_text(english: str) -> str:
    """Return a text of the protocol's tables in the language of the screen."""
    return _Reader.words.text(table_message(english))
