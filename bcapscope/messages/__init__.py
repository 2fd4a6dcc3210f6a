"""Sentences as data: ids with typed places, and their English and Japanese words.

Every room may make a `Message`. The words are in ``locale/*/LC_MESSAGES/bcapscope.po`` and nowhere else.
"""

from bcapscope.messages.language import Language, language_of
from bcapscope.messages.message import ENGLISH_WORDS, Message, MessageFormatter

__all__ = ["ENGLISH_WORDS", "Language", "Message", "MessageFormatter", "language_of"]
