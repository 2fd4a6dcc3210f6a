"""Command names that are nearly right: misread in a screenshot, or misspelt."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from difflib import get_close_matches
from typing import NamedTuple

from bcapscope.protocol.commands import command, commands
from bcapscope.protocol.content import Content

_NEAR_ENOUGH = 0.8
"""Share of letters that agree, as difflib counts it; two letters swapped in slvChangeMode give 0.92."""

_FEWEST_RIGHT = 3
"""One character in so many may be misread."""

_CHARACTERS_AT = 14
"""Where in a BSTR argument the characters begin: behind its length, type, count and byte length."""


class Spot(NamedTuple):
    """A byte that was misread: its offset in the frame, what stands there, what stood there."""

    offset: int
    found: int
    meant: int


class NearName(NamedTuple):
    """A command name that is not in the catalogue, and the one that it is near to.

    Attributes:
        name: as it stands in the frame.
        near: as the catalogue spells it.
        spots: bytes to change in order to get `near`; empty where all characters of `name` are ordinary
            ones, which nobody misreads that way: it is misspelt, or a command that is not known here.
    """

    name: str
    near: str
    spots: tuple[Spot, ...]


def near_name(request: bytes) -> NearName | None:
    """Look at the command of a request; None where it has none, or a known one, or one like no other."""
    content = Content(request)
    known = commands(content.code)
    if not known or len(content.arguments) < 2:
        return None
    argument = content.arguments[1]
    name = argument.variant.value
    if not isinstance(name, str) or command(content.code, name):
        return None
    for entry in known:
        if _is_misread(name, entry.name):
            return NearName(name, entry.name, tuple(_spots(request, argument.start, entry.name)))
    names = {entry.name.casefold(): entry.name for entry in known}
    close = get_close_matches(name.casefold()[: 2 * max(map(len, names))], names, 1, _NEAR_ENOUGH)
    return NearName(name, names[close[0]], ()) if close else None


def _is_misread(name: str, other: str) -> bool:
    """Tell whether `name` is `other` but for a few characters that no name has, each of one UTF-16 unit."""
    if len(name) != len(other) or max(name) > "\uffff":
        return False
    wrong = [a for a, b in zip(name, other, strict=True) if a.casefold() != b.casefold()]
    ordinary = any(character.isascii() and character.isalnum() for character in wrong)
    return bool(wrong) and not ordinary and len(wrong) * _FEWEST_RIGHT <= len(name)


def _spots(request: bytes, start: int, meant: str) -> Iterator[Spot]:
    at = start + _CHARACTERS_AT
    for index, character in enumerate(meant):
        offset = at + 2 * index
        (found,) = struct.unpack_from("<H", request, offset)
        if chr(found).casefold() != character.casefold():
            right = character.encode("utf-16-le")
            pairs = zip(request[offset : offset + 2], right, strict=True)
            yield from (Spot(offset + n, a, b) for n, (a, b) in enumerate(pairs) if a != b)
