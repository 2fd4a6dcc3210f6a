"""Sources of a capture's bytes: a file or a pipe, compressed or not."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import TypeAlias

from bcapscope.errors import CaptureError
from bcapscope.messages import Message

CHUNK_SIZE = 256 * 1024
"""Number of bytes to request per read. If a pipe holds fewer bytes, the read returns these bytes at once."""

GZIP_MAGIC = b"\x1f\x8b"
_GZIP_WINDOW = 31  # value of zlib's parameter `wbits` for data with a gzip header and the largest window


ChunkReader: TypeAlias = Callable[[int], bytes]
"""Function that returns at most the given number of bytes, as soon as bytes are available; b"" at the end."""


class ByteSource:
    """The part of a stream that a reader holds in memory. `offset` is the offset of `data` in the stream."""

    def __init__(self, read: ChunkReader) -> None:
        self._read = read
        self.data = b""
        self.offset = 0

    def advance(self, used: int) -> bool:
        """Drop the first `used` bytes of `data` and append new bytes; return False at the stream's end."""
        chunk = self._read(CHUNK_SIZE)
        self.data = self.data[used:] + chunk
        self.offset += used
        return bool(chunk)

    def ensure_bytes(self, size: int) -> bool:
        """Read until `data` has at least `size` bytes; return False if the stream ends earlier."""
        while len(self.data) < size:
            if not self.advance(0):
                return False
        return True


class GzipReader:
    """Decompresses a gzip file of one or several members while it is read.

    Python's own gzip reader waits until its buffer is full, and loses decompressed bytes that precede damage.
    """

    def __init__(self, read: ChunkReader, head: bytes) -> None:
        """`head` holds the bytes that the caller has already read from the stream."""
        self._read = read
        self._bytes_returned = 0
        self._tail = head
        self._decompressor = zlib.decompressobj(_GZIP_WINDOW)

    def __call__(self, size: int) -> bytes:
        """Return up to `size` bytes; b"" at the end. Raise CaptureError if only damaged data is left."""
        while True:
            if self._decompressor.eof and not self._next_member():
                return b""
            packed = self._tail or self._read(CHUNK_SIZE)
            if not packed:
                raise CaptureError(Message("capture.gzip.cut"), self._bytes_returned)
            data = self._unpack(packed, size)
            if data:
                self._bytes_returned += len(data)
                return data

    def _next_member(self) -> bool:
        """Return False if no gzip member follows. Zeros may follow the last member (gzip manual, "tapes")."""
        rest = self._decompressor.unused_data.lstrip(b"\x00")
        while len(rest) < len(GZIP_MAGIC):
            chunk = self._read(CHUNK_SIZE)
            if not chunk:
                break
            rest = (rest + chunk).lstrip(b"\x00")
        if not rest:
            return False
        self._tail, self._decompressor = rest, zlib.decompressobj(_GZIP_WINDOW)
        return True

    def _unpack(self, packed: bytes, size: int) -> bytes:
        before = self._decompressor.copy()
        try:
            data = self._decompressor.decompress(packed, size)
        except zlib.error as error:
            self._decompressor = before
            return self._salvage(packed, size, error)
        self._tail = self._decompressor.unconsumed_tail
        return data

    def _salvage(self, packed: bytes, size: int, error: zlib.error) -> bytes:
        """Decompress byte by byte up to the damage. Raise CaptureError if no byte precedes the damage."""
        data = bytearray()
        position = 0
        try:
            while position < len(packed) and len(data) < size:
                data += self._decompressor.decompress(packed[position : position + 1])
                position += 1
        except zlib.error:
            if not data:
                raise CaptureError(Message("capture.gzip.damaged"), self._bytes_returned) from error
        self._tail = packed[position:]
        return bytes(data)
