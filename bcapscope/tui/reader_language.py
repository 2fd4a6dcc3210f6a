"""The language of the screen, and labels in that language.

The message catalogue holds the labels; each id begins with the name of a screen or widget, such as
`shell.quit`.
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
    """Choose the language like `set_language`, and ignore the language in the settings."""
    set_language(language)
    _Reader.is_fixed = True


def apply_saved_language(name: str) -> None:
    """Choose the language in the settings, unless it is fixed; "" keeps the environment's language."""
    if name in tuple(Language) and not _Reader.is_fixed:
        set_language(Language(name))


def current_language() -> Language:
    """Return the language in which this process shows texts."""
    return _Reader.words.language


def reader_words() -> MessageFormatter:
    """Return the message formatter for the language of the screen."""
    return _Reader.words


def label(id: str, /, **places: PlaceValue) -> str:
    """Return a label of the screen by its id. The strings in `places` must be escaped already."""
    return _Reader.words(id, **places)


def full_error_text(error: Exception) -> str:
    """Return the text of an exception in the language of the screen."""
    return _Reader.words.text(message_of(error))


def table_text(english: str) -> str:
    """Return a text of the protocol's tables, such as a command's purpose, in the language of the screen."""
    return _Reader.words.text(table_message(english))
