"""Compressed frames of version 1 with every kind of zlib block, whole and damaged."""

from __future__ import annotations

import random
import zlib
from collections.abc import Iterator

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant

_LEVELS = (
    (0, zlib.Z_DEFAULT_STRATEGY),
    (9, zlib.Z_DEFAULT_STRATEGY),
    (9, zlib.Z_FIXED),
    (9, zlib.Z_HUFFMAN_ONLY),
    (9, zlib.Z_RLE),
)


def _with_body(body: bytes, claimed: int) -> bytes:
    content = claimed.to_bytes(4, "little") + body + b"\x01\x04"
    return b"\x01" + (9 + len(content)).to_bytes(4, "little") + b"\x05\x00\x01\x00" + content


def compressed_frames(count: int) -> Iterator[bytes]:
    """Yield `count` frames, the same in every run; most have a changed, missing or added byte."""
    chance = random.Random(5007)
    for index in range(count):
        letters = "".join(chance.choice("abcdefgh slvMove\u65e5") for _ in range(chance.choice((3, 40, 700))))
        plain = encode_frame(5, 1, 1, [Variant(VT.BSTR, letters * chance.choice((1, 5)))])[9:-1]
        level, strategy = _LEVELS[index % len(_LEVELS)]
        machine = zlib.compressobj(level, zlib.DEFLATED, 15, 9, strategy)
        body = bytearray(machine.compress(plain) + machine.flush())
        kind, at = index // len(_LEVELS) % 6, chance.randrange(2, len(body))
        if kind == 1:
            body[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            del body[at:]
        elif kind == 3:
            body += b"\x00\x01"
        elif kind == 4:
            body[min(at, 12)] = chance.randrange(256)
        yield _with_body(bytes(body), len(plain) + (kind == 5))
