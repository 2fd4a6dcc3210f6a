"""Errors of the operating system as messages."""

from __future__ import annotations

import errno

from bcapscope.messages.message import Message


def os_reason(error: OSError) -> Message:
    """Return why the operating system refused something, in lower case.

    Errors of name resolution have no number of `errno`; their text is in English only.
    """
    english = (error.strerror or str(error)).lower()
    name = errno.errorcode.get(error.errno or 0)
    is_resolver = type(error).__name__ in ("gaierror", "herror")
    return Message.from_table("os.other" if name is None or is_resolver else f"os.{name}", english)
