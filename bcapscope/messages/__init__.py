"""Sentences as data: each has an id, typed placeholders, and an English and a Japanese text.

All texts are in ``locale/*/LC_MESSAGES/bcapscope.po``, except for English texts in the tables of the
protocol.
"""

from bcapscope.messages.message import ENGLISH_WORDS, Language, Message, MessageFormatter, language_of

__all__ = ["ENGLISH_WORDS", "Language", "Message", "MessageFormatter", "language_of"]
