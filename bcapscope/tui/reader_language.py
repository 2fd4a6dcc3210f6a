"""The language of the screen, and the labels: messages that the screen shows in this language."""

from __future__ import annotations

import os

from bcapscope.errors import message_of
from bcapscope.messages import Language, MessageFormatter, language_of
from bcapscope.messages.message import PlaceValue
from bcapscope.protocol.tables.table_text import table_message


class _Reader:
    words = MessageFormatter(language_of(os.environ))


def set_language(name: str) -> None:
    """Choose the language of everything that this process shows; "" keeps the current language."""
    if name in tuple(Language):
        _Reader.words = MessageFormatter(Language(name))


def current_language() -> Language:
    return _Reader.words.language


def reader_words() -> MessageFormatter:
    return _Reader.words


def label(id: str, /, **places: PlaceValue) -> str:
    """Return a label of the screen by its id. The strings in `places` must be escaped already."""
    return _Reader.words(id, **places)


def full_error_text(error: Exception) -> str:
    return _Reader.words.text(message_of(error))


def table_text(english: str) -> str:
    """Translate a text of the protocol's tables, such as a command's purpose."""
    return _Reader.words.text(table_message(english))
