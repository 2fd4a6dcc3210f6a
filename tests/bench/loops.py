"""The least that Python can do about a capture: a loop of ``struct`` calls, once over headers, once over all.

These are no readers. They hold for what `traffic.py` writes (Ethernet, IPv4 without options, UDP, one sound
frame a packet), print nothing a frame, and so are the floor beneath every reader written in Python.
Run as ``python -m tests.bench.loops headers|arguments slave.pcap``.
"""

from __future__ import annotations

import mmap
import sys
from collections.abc import Iterator
from pathlib import Path
from struct import Struct

_RECORD = Struct("<IIII")
_HEADER = Struct("<BIHHiH")
_ARGUMENT = Struct("<IHI")
_LENGTH = Struct("<I")
_I4 = Struct("<i")
_DOUBLES = Struct("<8d")
_PAYLOAD = 14 + 20 + 8


def _frames(data: mmap.mmap) -> Iterator[int]:
    """Yield where each frame begins in the file."""
    at, size = 24, len(data)
    unpack = _RECORD.unpack_from
    while at < size:
        captured = unpack(data, at)[2]
        yield at + 16 + _PAYLOAD
        at += 16 + captured


def headers(data: mmap.mmap) -> int:
    """Unpack the header of every frame; return how many there were."""
    count = 0
    unpack = _HEADER.unpack_from
    for at in _frames(data):
        _soh, _length, _serial, _reserved, _code, _argc = unpack(data, at)
        count += 1
    return count


def _value(data: mmap.mmap, vt: int, at: int) -> object:
    if vt == 0x2005:
        return _DOUBLES.unpack_from(data, at)
    if vt == 3:
        return _I4.unpack_from(data, at)[0]
    if vt == 8:
        size = _LENGTH.unpack_from(data, at)[0]
        return data[at + 4 : at + 4 + size].decode("utf-16-le")
    return None


def arguments(data: mmap.mmap) -> int:
    """Unpack header and all arguments of every frame; return how many frames there were."""
    count = 0
    unpack, argument = _HEADER.unpack_from, _ARGUMENT.unpack_from
    for start in _frames(data):
        argc = unpack(data, start)[5]
        at = start + 15
        for _ in range(argc):
            size, vt, _count = argument(data, at)
            _value(data, vt, at + 10)
            at += 4 + size
        count += 1
    return count


if __name__ == "__main__":
    with Path(sys.argv[2]).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
        print({"headers": headers, "arguments": arguments}[sys.argv[1]](view))
