"""Errors of the operating system as messages."""

from __future__ import annotations

import errno
import os

from bcapscope.messages.message import Message


def os_reason(error: Exception) -> Message:
    """Return the reason for `error` in lower case, without the text that Python adds to the reason.

    If the first argument of `error` is a `Message`, return this message. bcapscope finds the translation of
    an error by its `errno` number. Errors of name resolution have other numbers, which can equal an unrelated
    `errno` number, so bcapscope does not translate these errors.
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
