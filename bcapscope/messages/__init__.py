"""Sentences as data: ids with typed places, and their English and Japanese words.

Every package may create a `Message`. All words are in ``locale/*/LC_MESSAGES/bcapscope.po``, except for the
English texts of the protocol's tables.
"""

from bcapscope.messages.message import ENGLISH_WORDS, Language, Message, MessageFormatter, language_of

__all__ = ["ENGLISH_WORDS", "Language", "Message", "MessageFormatter", "language_of"]
