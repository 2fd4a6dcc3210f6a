"""Messages as English text, for comparison with what users read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.message_codec import decode_message, encode_message


def english(message: Message | None) -> str:
    """Return a message as text; "" for none."""
    return "" if message is None else str(message)


def with_english(value: Any) -> tuple[Any, ...]:
    """Return the type and the fields of a struct or data class, with its messages as text."""
    names = getattr(value, "__struct_fields__", None) or value.__dataclass_fields__
    found = (getattr(value, name) for name in names)
    return type(value), *(str(each) if isinstance(each, Message) else each for each in found)


def collects(texts: list[str]) -> Callable[[Message], None]:
    """Return a callback that adds messages to `texts`."""
    return lambda message: texts.append(str(message))


def encoded(text: str) -> bytes:
    """Return a message with this text, encoded; b"" for none."""
    return encode_message(foreign_text(text)) if text else b""


def decoded(note: bytes) -> str:
    """Return the text of an encoded message; "" for none."""
    return str(decode_message(note)) if note else ""
