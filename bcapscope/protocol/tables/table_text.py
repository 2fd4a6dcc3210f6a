"""Texts of the protocol's tables as messages: what commands do and take, and what numbers and keys mean."""

from __future__ import annotations

import re
from functools import lru_cache

from bcapscope.messages import Message

_SEPARATORS = re.compile(r"[^a-z0-9]+")


@lru_cache(1024)
def table_message(english: str) -> Message:
    """Return the message of a table's English text. Its id is made of the text."""
    return Message.from_table(f"table.{_SEPARATORS.sub('-', english.lower()).strip('-')}", english)
