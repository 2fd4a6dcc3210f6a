"""Problems with a given text."""

from __future__ import annotations

from bcapscope.messages import Message
from bcapscope.protocol.codec.arguments import Problem


def problem_of(offset: int, code: str, reason: str) -> Problem:
    """Return a problem whose reason is this text."""
    return Problem(offset, code, Message.from_table("text", reason))
