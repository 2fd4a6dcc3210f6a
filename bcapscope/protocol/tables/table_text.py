"""The English texts of the protocol's tables as translatable messages."""

from __future__ import annotations

import re
from functools import lru_cache

from bcapscope.messages import Message

_SEPARATORS = re.compile(r"[^a-z0-9]+")


@lru_cache(1024)
def table_message(english: str) -> Message:
    """Turn an English text from a protocol table into a message; its id is derived from the text."""
    return Message.from_table(f"table.{_SEPARATORS.sub('-', english.lower()).strip('-')}", english)
