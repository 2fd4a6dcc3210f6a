"""Errors of the operating system as messages."""

from __future__ import annotations

import errno
import os

from bcapscope.messages.message import Message


def os_reason(error: Exception) -> Message:
    """Return the reason in lower case and without the text that Python adds.

    If the first argument of `error` is a `Message`, return this message. Errors of name resolution have
    numbers of their own, so their text is in English only.
    """
    if error.args and isinstance(error.args[0], Message):
        return error.args[0]
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, TimeoutError) and number is None:
        return Message("os.no-answer")
    name = errno.errorcode.get(number or 0)
    if number and name and type(error).__name__ not in ("gaierror", "herror"):
        return Message.from_table(f"os.{name}", os.strerror(number).lower())
    return Message.from_table("os.other", str(getattr(error, "strerror", None) or error).lower())
