"""Escape text from the wire, so that it cannot control the terminal or start a new line."""

from __future__ import annotations

_NAMED = {"\n": "\\n", "\r": "\\r", "\t": "\\t", "\0": "\\0"}

_KEPT = frozenset("\u3000")  # the ideographic space: not `isprintable`, but common in Japanese


def printable(text: str) -> str:
    """Escape every non-printable character, such as ``\\n``, ``\\xNN``, ``\\uNNNN`` or ``\\UNNNNNNNN``.

    Non-printable characters are control characters (C0, C1, DEL), formatting characters such as bidirectional
    overrides, separators except the space and U+3000, lone surrogates, private and unassigned characters. The
    result can be encoded in UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() or char in _KEPT else _escaped(char) for char in text)


def quoted(text: str) -> str:
    """Return `text` in double quotes, with quotes, backslashes and non-printable characters escaped."""
    return '"' + printable(text.replace("\\", "\\\\").replace('"', '\\"')) + '"'


def _escaped(char: str) -> str:
    code = ord(char)
    if char in _NAMED:
        return _NAMED[char]
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
