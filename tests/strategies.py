"""Strategies for hypothesis: values, frames, garbage and the ways to cut a stream."""

from __future__ import annotations

import struct
from functools import cache
from typing import NamedTuple

from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Framing, encode_frame
from bcapscope.protocol.codec.variant import NUMBER_FORMATS, VT, Value, Variant
from tests.frames import FRAMES

INTEGER_BITS = {
    VT.I2: -16,
    VT.I4: -32,
    VT.CY: -64,
    VT.ERROR: -32,
    VT.UI1: 8,
    VT.UI2: 16,
    VT.UI4: 32,
    VT.I8: -64,
    VT.UI8: 64,
}
"""Width of each integer type, negative for signed ones."""

TEXTS = st.text(st.characters(), max_size=6) | st.sampled_from(
    ["\ud83d", "\ude00\ud83d", "a\0b", "\U0001f600"]
)
"""Strings as UTF-16 can carry them; surrogates stand alone or the wrong way round, never as a pair."""


def numbers(vt: int) -> st.SearchStrategy[Value]:
    """Draw a value of a type of fixed width; NaN among them."""
    if vt == VT.BOOL:
        return st.booleans()
    if vt in INTEGER_BITS:
        bits = INTEGER_BITS[VT(vt)]
        return (
            st.integers(-(2 ** (-bits - 1)), 2 ** (-bits - 1) - 1)
            if bits < 0
            else st.integers(0, 2**bits - 1)
        )
    return st.floats(width=32 if vt == VT.R4 else 64)


@cache
def scalars() -> st.SearchStrategy[Variant]:
    """Draw a VARIANT that is no array."""
    plain = [st.builds(Variant, st.just(int(vt)), numbers(vt), st.just(1)) for vt in NUMBER_FORMATS]
    empties = st.builds(Variant, st.sampled_from([0, 1]), st.none(), st.integers(0, 1))
    return st.one_of(*plain, st.builds(Variant, st.just(int(VT.BSTR)), TEXTS, st.just(1)), empties)


def _array(vt: int, size: int) -> st.SearchStrategy[Variant]:
    if vt == VT.UI1:
        return st.binary(max_size=size * 3).map(lambda data: Variant.array(VT.UI1, data))
    items = TEXTS if vt == VT.BSTR else numbers(vt)
    return st.lists(items, max_size=size).map(lambda values: Variant.array(vt, tuple(values)))


@cache
def arrays(size: int = 3) -> st.SearchStrategy[Variant]:
    """Draw an array of any element type but VARIANT."""
    return st.one_of(*(_array(vt, size) for vt in (*NUMBER_FORMATS, VT.BSTR)))


def _nest(inner: st.SearchStrategy[Variant]) -> st.SearchStrategy[Variant]:
    return st.lists(inner, max_size=3).map(lambda values: Variant.array(VT.VARIANT, tuple(values)))


@cache
def variants() -> st.SearchStrategy[Variant]:
    """Draw any VARIANT, VARIANT arrays up to three deep."""
    leaf = scalars() | arrays()
    shallow = leaf | _nest(leaf)
    return leaf | _nest(leaf) | _nest(shallow | _nest(shallow))


@cache
def _argument_lists() -> st.SearchStrategy[list[Variant]]:
    return st.lists(variants(), max_size=3)


class Plan(NamedTuple):
    """What a frame is made from, in the order of the arguments of `encode_frame`."""

    serial: int
    reserved: int
    code: int
    arguments: list[Variant]
    framing: Framing


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    """Draw what `encode_frame` takes."""
    framing = draw(st.sampled_from(Framing))
    version_1 = framing in (Framing.VERSION_1, Framing.VERSION_1_ZLIB)
    reserved = 1 if version_1 else draw(st.sampled_from([0, 1, 65535]))
    code = draw(st.integers(0, 140) | st.integers(0, 2**32 - 1))
    return Plan(draw(st.integers(0, 65535)), reserved, code, draw(_argument_lists()), framing)


@cache
def frames() -> st.SearchStrategy[bytes]:
    """Draw the bytes of a sound frame."""
    return st.sampled_from([pair.data for pair in FRAMES]) | plans().map(lambda plan: encode_frame(*plan))


_SPLINTERS = st.binary(max_size=4) | st.sampled_from(
    [
        b"\x00",
        b"\x01",
        b"\x04",
        b"\xff\xff\xff\xff",
        b"\x11\x20",
        b"\x0c\x20",
        b"\x06\x00\x00\x00",
        b"\x80",
    ]
)


@st.composite
def mutated_frames(draw: st.DrawFn) -> bytes:
    """Draw a frame with a few bytes changed, dropped, repeated or put in."""
    data = bytearray(draw(frames()))
    for _ in range(draw(st.integers(1, 4))):
        spot = draw(st.integers(0, len(data)))
        dropped = draw(st.sampled_from([0, 1, 1, 1, 2, 4]))
        data[spot : spot + dropped] = draw(_SPLINTERS)
    return bytes(data)


@cache
def sound_or_mutated_frames() -> st.SearchStrategy[bytes]:
    """Draw a sound frame, or twice as often a mutated one."""
    return st.one_of(frames(), mutated_frames(), mutated_frames())


@cache
def garbage() -> st.SearchStrategy[bytes]:
    """Draw bytes of no frame, rich in what frames begin with."""
    bait = st.sampled_from(
        [
            b"\x01",
            b"\x01\x10\x00\x00\x00",
            b"\x01" + struct.pack("<IHHIH", 40, 1, 0, 64, 1),
            b"\x04",
            b"\x00\x00",
        ]
    )
    return st.lists(bait | st.binary(max_size=6), max_size=8).map(b"".join)


def streams() -> st.SearchStrategy[bytes]:
    """Draw sound frames, damaged ones and garbage, one behind the other."""
    return st.lists(frames() | mutated_frames() | garbage(), max_size=4).map(b"".join)


@st.composite
def cut(draw: st.DrawFn, data: bytes) -> list[bytes]:
    """Draw a way to cut `data`; empty parts among them."""
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=8)))
    return [data[start:stop] for start, stop in zip([0, *cuts], [*cuts, len(data)], strict=True)]
