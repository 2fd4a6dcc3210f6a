"""Find the intended command of a name that was misread from a screenshot or misspelt."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from difflib import get_close_matches
from typing import NamedTuple

from bcapscope.protocol.codec.frame_content import FrameContent
from bcapscope.protocol.tables.command_catalogue import commands_of, find_command

_SMALLEST_SIMILARITY = 0.8
"""Smallest similarity ratio, as difflib computes it. Two swapped letters in slvChangeMode give 0.92."""

_CHARACTERS_PER_MISREAD = 3
"""Minimum number of characters of a name per misread character."""

_CHARACTERS_AT = 14
"""Offset of the characters in a BSTR argument, after the argument's length, type, count and string length."""


class MisreadByte(NamedTuple):
    """A misread byte: its offset in the frame, the value found, and the value expected."""

    offset: int
    found: int
    expected: int


class SimilarCommand(NamedTuple):
    """A command name that is not in the command catalogue, and the most similar name that is.

    Attributes:
        name: Command name in the frame.
        catalogue_name: Most similar command name in the catalogue.
        misread_bytes: Bytes to change to get `catalogue_name`. Empty if all characters of `name` occur in
            command names: then the name is misspelt, or the catalogue lacks it.
    """

    name: str
    catalogue_name: str
    misread_bytes: tuple[MisreadByte, ...]


def find_similar_command(request: bytes) -> SimilarCommand | None:
    """Return the known command that resembles the unknown command of a request.

    Returns None if the request has no command, if its command is known, or if no known command is similar.
    """
    content = FrameContent(request)
    known = commands_of(content.code)
    if not known or len(content.arguments) < 2:
        return None
    argument = content.arguments[1]
    name = argument.variant.value
    if not isinstance(name, str) or find_command(content.code, name):
        return None
    for entry in known:
        if _is_misread(name, entry.name):
            return SimilarCommand(
                name, entry.name, tuple(_misread_bytes(request, argument.start, entry.name))
            )
    names = {entry.name.casefold(): entry.name for entry in known}
    close = get_close_matches(name.casefold()[: 2 * max(map(len, names))], names, 1, _SMALLEST_SIMILARITY)
    return SimilarCommand(name, names[close[0]], ()) if close else None


def _is_misread(name: str, other: str) -> bool:
    """Return whether `name` differs from `other` only in a few characters that occur in no command name.

    Each differing character must have one UTF-16 unit.
    """
    if len(name) != len(other) or max(name) > "\uffff":
        return False
    wrong = [a for a, b in zip(name, other, strict=True) if a.casefold() != b.casefold()]
    ordinary = any(character.isascii() and character.isalnum() for character in wrong)
    return bool(wrong) and not ordinary and len(wrong) * _CHARACTERS_PER_MISREAD <= len(name)


def _misread_bytes(request: bytes, start: int, meant: str) -> Iterator[MisreadByte]:
    at = start + _CHARACTERS_AT
    for index, character in enumerate(meant):
        offset = at + 2 * index
        (found,) = struct.unpack_from("<H", request, offset)
        if chr(found).casefold() != character.casefold():
            right = character.encode("utf-16-le")
            pairs = zip(request[offset : offset + 2], right, strict=True)
            yield from (MisreadByte(offset + n, a, b) for n, (a, b) in enumerate(pairs) if a != b)
