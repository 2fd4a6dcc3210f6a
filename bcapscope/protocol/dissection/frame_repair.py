"""Probable causes of a damaged frame: lost or surplus zero bytes, a missing end, a misread name.

Frames that people copy from a document, a mail or a screenshot have such damage. Most bytes of a frame are
zeros, so zeros get lost or doubled. Nearly every dump in DENSO Wave 2009, How to use the Slave mode, has such
damage. Every repair is a guess, and bcapscope presents it as a guess. A repair never changes the original
bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.protocol.codec.frame_content import EOT, HEADER_SIZE, SOH, FrameContent
from bcapscope.protocol.codec.variant import Value, Variant
from bcapscope.protocol.dissection.plausibility import (
    plausible_argument_end,
    plausible_length_field,
    plausible_prefix_length,
)
from bcapscope.protocol.dissection.similar_commands import find_similar_command

LONGEST_REPAIRED = 1024
"""Largest frame, in bytes, whose lost zeros a repair looks for. UDP frames have at most 503 bytes (orin_bcap
dn_udp.h)."""

MAX_EDITS = 2
"""Maximum number of zeros that a repair inserts or removes."""

_SMALLEST_LIKELY, _LARGEST_LIKELY = 1e-6, 1e9
"""Range of plausible magnitudes of positions, speeds and times."""


class ByteEdit(NamedTuple):
    """A change that a repair makes at one place of a damaged frame.

    Attributes:
        offset: Offset of the change in the original bytes.
        found: Original bytes at the offset; empty if bytes were lost.
        expected: Bytes that replace `found`; empty if the original bytes are surplus.
    """

    offset: int
    found: bytes
    expected: bytes


class FrameRepair(NamedTuple):
    """What a frame, or a separate argument, probably was before the damage.

    Attributes:
        raw: Bytes of the frame or argument after the edits, without the bytes missing at the end.
        edits: Changes in the order of their offsets; empty if only the end is missing.
        missing_at_end: Number of bytes missing at the end of the frame or argument.
        is_argument: Whether the bytes are an argument instead of a frame.
    """

    raw: bytes
    edits: tuple[ByteEdit, ...]
    missing_at_end: int = 0
    is_argument: bool = False


def find_repair(raw: bytes, is_request: bool | None = None) -> FrameRepair | None:
    """Find the smallest damage that explains why `raw`, a frame or one argument of a frame, is not sound.

    Returns None for a sound frame whose command was not misread, and if no small damage explains the
    problems. The repaired bytes begin or form a sound frame with an existing function or result code.
    `is_request` is None if the sender is not known.
    """
    if raw[:1] != bytes((SOH,)) or len(raw) < HEADER_SIZE:
        return _without_soh(raw, is_request) or _argument(raw)
    length = plausible_length_field(raw)
    if length == len(raw) and not FrameContent(raw).problems:
        return _misread_command(raw, is_request)
    return _wrong_ends(raw, length, is_request) or _changed_zeros(raw, length, is_request)


def _misread_command(raw: bytes, is_request: bool | None) -> FrameRepair | None:
    """Repair a command name of a sound request in which single characters were misread."""
    name = None if is_request is False else find_similar_command(raw)
    if name is None or not name.misread_bytes:
        return None
    data = bytearray(raw)
    for offset, _, meant in name.misread_bytes:
        data[offset] = meant
    edits = (
        ByteEdit(offset, bytes((found,)), bytes((meant,))) for offset, found, meant in name.misread_bytes
    )
    return FrameRepair(bytes(data), tuple(edits))


def _without_soh(raw: bytes, is_request: bool | None) -> FrameRepair | None:
    data = bytes((SOH,)) + raw
    length = plausible_length_field(data)
    if length != len(data) or plausible_prefix_length(data, length, is_request) != length:
        return None
    return FrameRepair(data, (ByteEdit(0, b"", data[:1]),))


def _wrong_ends(raw: bytes, length: int | None, is_request: bool | None) -> FrameRepair | None:
    """Repair a frame with a wrong length field, a wrong EOT, or surplus bytes after EOT."""
    size = len(raw)
    if plausible_prefix_length(raw, size, is_request) == size:
        right = size.to_bytes(4, "little")
        return FrameRepair(raw[:1] + right + raw[5:], (ByteEdit(1, raw[1:5], right),))
    if length is not None and length < size and plausible_prefix_length(raw, length, is_request) == length:
        return FrameRepair(raw[:length], (ByteEdit(length, raw[length:], b""),))
    data = raw[:-1] + bytes((EOT,))
    if length == size and plausible_prefix_length(data, size, is_request) == size:
        return FrameRepair(data, (ByteEdit(size - 1, raw[-1:], data[-1:]),))
    return None


def _changed_zeros(raw: bytes, length: int | None, is_request: bool | None) -> FrameRepair | None:
    """Insert or remove zeros until the frame fits its length field; else assume that the end is missing."""
    lacking = 1 if length is None else length - len(raw)
    versions = _with_changed_zeros(raw, lacking, is_request)
    if len(versions) == abs(lacking) + 1 and _sound_prefix(versions[-1], is_request) == len(versions[-1]):
        return FrameRepair(versions[-1], _zero_edits(raw, versions[-1]))
    for data in versions:
        if length is not None and len(data) < length and _sound_prefix(data, is_request) == len(data):
            return FrameRepair(data, _zero_edits(raw, data), length - len(data))
    return None


def _with_changed_zeros(raw: bytes, lacking: int, is_request: bool | None) -> list[bytes]:
    """Return `raw`, then `raw` with one and two zeros changed where that makes the longest prefix sound."""
    versions = [raw]
    for _ in range(min(abs(lacking), MAX_EDITS) if len(raw) <= LONGEST_REPAIRED else 0):
        edited = _one_zero_more(versions[-1]) if lacking > 0 else _one_zero_less(versions[-1])
        reached = [(_sound_prefix(data, is_request), data, run) for data, run in edited]
        furthest = max((prefix for prefix, _, _ in reached), default=0)
        best = [(data, run) for prefix, data, run in reached if prefix == furthest]
        if not best:
            break
        versions.append(min(best, key=lambda choice: (_strange_arguments(choice[0]), -choice[1]))[0])
    return versions


def _sound_prefix(data: bytes, is_request: bool | None) -> int:
    length = plausible_length_field(data)
    return 1 if length is None else plausible_prefix_length(data, length, is_request)


def _one_zero_more(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield `data` with one more zero after each run of zeros or other byte, and the length of the run.

    People lose a byte most easily in a long run of zeros.
    """
    run = 0
    for at in range(1, len(data) + 1):
        run = run + 1 if data[at - 1] == 0 else 0
        if at == len(data) or data[at]:
            yield data[:at] + b"\0" + data[at:], run


def _one_zero_less(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield `data` without the last zero of each run, and the length of the run."""
    for zeros in re.finditer(rb"\0+", data):
        yield data[: zeros.end() - 1] + data[zeros.end() :], zeros.end() - zeros.start()


def _zero_edits(raw: bytes, repaired: bytes) -> tuple[ByteEdit, ...]:
    """Return the edits that turn `raw` into `repaired`; each edit inserts or removes zero bytes."""
    edits: list[ByteEdit] = []
    at = to = 0
    while at < len(raw) or to < len(repaired):
        if raw[at : at + 1] == repaired[to : to + 1]:
            at, to = at + 1, to + 1
        elif repaired[to : to + 1] == b"\0":
            if edits and edits[-1].offset == at:
                edits[-1] = ByteEdit(at, b"", edits[-1].expected + b"\0")
            else:
                edits.append(ByteEdit(at, b"", b"\0"))
            to += 1
        else:
            edits.append(ByteEdit(at, b"\0", b""))
            at += 1
    return tuple(edits)


def _strange_arguments(data: bytes) -> int:
    return sum(_strange(argument.variant.value) for argument in FrameContent(data).arguments)


def _strange(value: Value | Variant) -> int:
    """Return a score of how unusual a value is; small numbers and ASCII text score 0.

    A zero inserted at the wrong end of a number multiplies the number by 256. A zero inserted into a string
    changes its letters into those of another alphabet.
    """
    if isinstance(value, Variant):
        return _strange(value.value)
    if isinstance(value, tuple):
        return sum(map(_strange, value))
    if isinstance(value, float):
        return value != 0 and not _SMALLEST_LIKELY <= abs(value) <= _LARGEST_LIKELY
    if isinstance(value, int):
        return abs(value).bit_length() // 8
    if isinstance(value, str):
        return sum(not character.isascii() or not character.isprintable() for character in value)
    return 0


def _argument(raw: bytes) -> FrameRepair | None:
    """Repair an argument that stands alone, such as an argument copied from a table of fields."""
    if plausible_argument_end(raw) == len(raw):
        return FrameRepair(raw, (), is_argument=True)
    if not raw or len(raw) > LONGEST_REPAIRED:
        return None
    turned = raw[-1:] + raw[:-1]
    if plausible_argument_end(turned) == len(raw):
        edits = (ByteEdit(0, b"", raw[-1:]), ByteEdit(len(raw) - 1, raw[-1:], b""))
        return FrameRepair(turned, edits, is_argument=True)
    for edited in (_one_zero_less, _one_zero_more):
        whole = [(data, run) for data, run in edited(raw) if plausible_argument_end(data) == len(data)]
        if whole:
            best = max(whole, key=lambda choice: choice[1])[0]
            return FrameRepair(best, _zero_edits(raw, best), is_argument=True)
    return None
