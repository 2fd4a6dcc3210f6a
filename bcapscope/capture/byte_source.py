"""The bytes of a capture as they come: from a file, a pipe, compressed or not."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import TypeAlias

from bcapscope.errors import CaptureError

CHUNK_SIZE = 256 * 1024
"""Bytes asked for at once. A pipe gives what it has, so that this delays nothing."""

GZIP_MAGIC = b"\x1f\x8b"
_GZIP_WINDOW = 31  # zlib's notation for the largest window behind a gzip header


ChunkReader: TypeAlias = Callable[[int], bytes]
"""Gives at most so many bytes as soon as it has any, and b"" at the end of the stream."""


class ByteSource:
    """A window on a stream of bytes that only moves forward.

    Attributes:
        data: what is at hand.
        offset: where in the capture `data` begins.
    """

    __slots__ = ("_read", "data", "offset")

    def __init__(self, read: ChunkReader) -> None:
        self._read = read
        self.data = b""
        self.offset = 0

    def advance(self, used: int) -> bool:
        """Drop the first `used` bytes of `data` and add what comes next.

        Returns:
            Whether anything came; False at the end of the stream.
        """
        chunk = self._read(CHUNK_SIZE)
        self.data = self.data[used:] + chunk
        self.offset += used
        return bool(chunk)

    def ensure_bytes(self, size: int) -> bool:
        """Have at least `size` bytes in `data`, if the stream has them."""
        while len(self.data) < size:
            if not self.advance(0):
                return False
        return True


class GzipReader:
    """Unpacks a gzip file of one or several members while it is being read.

    The standard library's reader waits for full buffers, and loses what it unpacked before damage.
    """

    __slots__ = ("_bytes_returned", "_decompressor", "_read", "_tail")

    def __init__(self, read: ChunkReader, head: bytes) -> None:
        """Unpack `head`, already taken from the stream, and what `read` gives after it."""
        self._read = read
        self._bytes_returned = 0
        self._tail = head
        self._decompressor = zlib.decompressobj(_GZIP_WINDOW)

    def __call__(self, size: int) -> bytes:
        """Return up to `size` unpacked bytes, b"" at the end.

        Raises:
            CaptureError: the compressed data end early or are damaged; all before that was returned.
        """
        while True:
            if self._decompressor.eof and not self._next_member():
                return b""
            packed = self._tail or self._read(CHUNK_SIZE)
            if not packed:
                raise CaptureError("the compressed file ends in the middle", self._bytes_returned)
            data = self._unpack(packed, size)
            if data:
                self._bytes_returned += len(data)
                return data

    def _next_member(self) -> bool:
        """Go on to the next member; padding by zeros is allowed behind the last (gzip manual, "tapes")."""
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
        """Return what comes out byte by byte before the damage; raise once nothing does."""
        data = bytearray()
        position = 0
        try:
            while position < len(packed) and len(data) < size:
                data += self._decompressor.decompress(packed[position : position + 1])
                position += 1
        except zlib.error:
            if not data:
                raise CaptureError("the compressed file is damaged", self._bytes_returned) from error
        self._tail = packed[position:]
        return bytes(data)
