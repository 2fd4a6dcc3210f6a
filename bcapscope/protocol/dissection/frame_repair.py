"""Probable causes of a damaged frame: lost or surplus zero bytes, a missing end, a misread name.

Frames that were copied through a document, a mail or a screenshot have such damage. Most bytes of a frame are
zeros, so zeros get lost or doubled, as in nearly every dump of DENSO Wave 2009, How to use the Slave mode.
The result is a guess and is worded as one. The original bytes are never changed.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

from bcapscope.protocol.codec.frame_content import EOT, HEADER_SIZE, SOH, FrameContent
from bcapscope.protocol.codec.variant import Value, Variant
from bcapscope.protocol.dissection.plausibility import (
    plausible_argument_end,
    plausible_length_field,
    plausible_prefix_length,
)
from bcapscope.protocol.dissection.similar_commands import find_similar_command

LONGEST_SEARCHED = 1024
"""Largest frame, in bytes, that is searched for lost bytes; on UDP none has more than 503 (orin_bcap
dn_udp.h)."""

MAX_EDITS = 2
_BEAM = 24
"""Number of first edits that the search continues with a second one."""

_SMALLEST_LIKELY, _LARGEST_LIKELY = 1e-6, 1e9
"""Range of magnitudes of positions, speeds and times."""


class ByteEdit(NamedTuple):
    """One place where the bytes were changed.

    Attributes:
        offset: Offset in the original bytes.
        found: Bytes found there; empty if bytes were lost.
        expected: Bytes that should be there; empty if the found bytes are surplus.
    """

    offset: int
    found: bytes
    expected: bytes


class FrameRepair(NamedTuple):
    """What a frame, or a separate argument, probably was before the damage.

    Attributes:
        raw: Its bytes after the edits, without those missing at the end.
        edits: Edits in the order of their offsets; none if only the end is missing.
        missing_at_end: Number of bytes missing at the end.
        is_argument: Whether this is one argument instead of a frame.
    """

    raw: bytes
    edits: tuple[ByteEdit, ...]
    missing_at_end: int = 0
    is_argument: bool = False


class _State(NamedTuple):
    """An intermediate result of the search for a sound frame.

    Attributes:
        data: The bytes after the changes so far.
        changes: Changes so far: +1 for an inserted zero or -1 for a removed one, and its offset in the bytes
            just
        before that change.
        zeros: Total length of the runs of zeros that were changed; a byte gets lost most easily in a long
            run.
    """

    data: bytes
    changes: tuple[tuple[int, int], ...]
    zeros: int


_Step = Callable[[_State], Iterator[_State]]


def find_repair(raw: bytes, is_request: bool | None = None) -> FrameRepair | None:
    """Find the smallest damage that explains why `raw` is no sound frame.

    Args:
        raw: One frame, or one argument of a frame.
        is_request: Whether the client sent it; None if unknown.

    Returns:
        The repair. None for a sound frame whose command was not misread, or if no small damage explains the
        problems. The repaired bytes are sound as far as they go, with an existing function or result.
    """
    if raw[:1] != bytes((SOH,)) or len(raw) < HEADER_SIZE:
        return _without_soh(raw, is_request) or _argument(raw)
    length = plausible_length_field(raw)
    if length == len(raw) and not FrameContent(raw).problems:
        return _misread_command(raw, is_request)
    for attempt in (_wrong_ends, _changed_zeros, _cut_end):
        found = attempt(raw, length, is_request)
        if found is not None:
            return found
    return None


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
    """Repair a frame of which only the length field or EOT is wrong, or that has surplus bytes after it."""
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
    """Find lost, surplus or moved zero bytes; the length field determines how many."""
    plans: tuple[tuple[_Step, ...], ...]
    if len(raw) > LONGEST_SEARCHED:
        plans = ()
    elif length is None:
        plans = ((_lost,), (_surplus,), (_lost, _lost))
    elif length == len(raw):
        plans = ((_lost, _surplus),)
    elif abs(length - len(raw)) <= MAX_EDITS:
        plans = ((_lost if length > len(raw) else _surplus,) * abs(length - len(raw)),)
    else:
        return None
    for plan in plans:
        sound = [state for state in _search(raw, plan, is_request) if _is_sound(state.data, is_request)]
        if sound:
            best = min(sound, key=_preference)
            return FrameRepair(best.data, _edits(best))
    return None


def _cut_end(raw: bytes, length: int | None, is_request: bool | None) -> FrameRepair | None:
    """Find out whether the end is missing, and whether zero bytes were lost before it."""
    for lost in range(1 if len(raw) > LONGEST_SEARCHED else MAX_EDITS + 1):
        if length is None or length <= len(raw) + lost:
            return None
        states = _search(raw, (_lost,) * lost, is_request)
        whole = [
            state
            for state in states
            if plausible_prefix_length(state.data, length, is_request) == len(state.data)
        ]
        if whole:
            best = min(whole, key=_preference)
            return FrameRepair(best.data, _edits(best), length - len(best.data))
    return None


def _search(raw: bytes, plan: tuple[_Step, ...], is_request: bool | None) -> list[_State]:
    """Apply each step of `plan` at every offset; keep the most promising states between steps."""
    states = [_State(raw, (), 0)]
    for step in plan:
        states = heapq.nlargest(
            _BEAM, states, key=lambda state: (_progress(state.data, is_request), state.zeros)
        )
        made = {after.data: after for state in states for after in step(state)}
        states = list(made.values())
    return states


def _progress(data: bytes, is_request: bool | None) -> int:
    length = plausible_length_field(data)
    return 1 if length is None else plausible_prefix_length(data, length, is_request)


def _is_sound(data: bytes, is_request: bool | None) -> bool:
    length = plausible_length_field(data)
    return length == len(data) and plausible_prefix_length(data, length, is_request) == length


def _lost(state: _State) -> Iterator[_State]:
    """Yield states with one zero inserted: at the end of each run of zeros, or between other bytes."""
    data = state.data
    run = 0
    for at in range(1, len(data) + 1):
        run = run + 1 if data[at - 1] == 0 else 0
        if at == len(data) or data[at]:
            changed = data[:at] + b"\0" + data[at:]
            yield _State(changed, (*state.changes, (1, at)), state.zeros + run)


def _surplus(state: _State) -> Iterator[_State]:
    """Yield states with one zero removed, the last one of each run."""
    data = state.data
    run = 0
    for at in range(1, len(data)):
        run = run + 1 if data[at] == 0 else 0
        if run and (at + 1 == len(data) or data[at + 1]):
            changed = data[:at] + data[at + 1 :]
            yield _State(changed, (*state.changes, (-1, at)), state.zeros + run)


def _edits(state: _State) -> tuple[ByteEdit, ...]:
    """Convert the changes to edits with offsets in the original bytes."""
    lost: Counter[int] = Counter()
    edits = []
    for index, (change, place) in enumerate(state.changes):
        at = place
        for earlier, where in reversed(state.changes[:index]):
            at += at >= where if earlier < 0 else -(at > where)
        if change > 0:
            lost[at] += 1
        else:
            edits.append(ByteEdit(at, b"\0", b""))
    edits += (ByteEdit(at, b"", bytes(count)) for at, count in lost.items())
    return tuple(sorted(edits))


def _preference(state: _State) -> tuple[int, int, tuple[tuple[int, int], ...]]:
    """Return the sort key of a repair: likely values first, then changes in the longest runs of zeros."""
    strange = sum(_strange(argument.variant.value) for argument in FrameContent(state.data).arguments)
    return strange, -state.zeros, state.changes


def _strange(value: Value | Variant) -> int:
    """Return how unusual a value is; small numbers and ASCII letters are usual.

    A zero inserted at the wrong end of a number multiplies it by 256. A zero inserted into a string turns its
    letters into those of another alphabet.
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
    """Repair a separate argument, such as one from a table of fields."""
    if plausible_argument_end(raw) == len(raw):
        return FrameRepair(raw, (), is_argument=True)
    if not raw or len(raw) > LONGEST_SEARCHED:
        return None
    turned = raw[-1:] + raw[:-1]
    if plausible_argument_end(turned) == len(raw):
        edits = (ByteEdit(0, b"", raw[-1:]), ByteEdit(len(raw) - 1, raw[-1:], b""))
        return FrameRepair(turned, edits, is_argument=True)
    for step in (_surplus, _lost):
        whole = [
            state
            for state in step(_State(raw, (), 0))
            if plausible_argument_end(state.data) == len(state.data)
        ]
        if whole:
            best = min(whole, key=lambda state: (-state.zeros, state.changes))
            return FrameRepair(best.data, _edits(best), is_argument=True)
    return None
