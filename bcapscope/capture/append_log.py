"""Files that one process appends to while others read anywhere in them."""

from __future__ import annotations

import os
import struct
from io import RawIOBase
from pathlib import Path
from typing import BinaryIO

_READ_AHEAD = 64 * 1024
"""Bytes read at once: what is shown on one screen lies close together."""

_OFFSET = struct.Struct("<Q")


class AppendLogWriter:
    """Appends records to a file, and where each begins to another; nothing is there before `flush`.

    Attributes:
        count: records so far.
    """

    def __init__(self, path: Path) -> None:
        """Make `path` and an index beside it, which must not exist."""
        self._file: BinaryIO = path.open("xb", buffering=0)
        self._index: BinaryIO = _index_path(path).open("xb", buffering=0)
        self._pending = bytearray()
        self._offsets = bytearray()
        self._end = 0
        self.count = 0

    def add(self, record: bytes) -> None:
        """Append a record."""
        self._offsets += _OFFSET.pack(self._end)
        self._pending += record
        self._end += len(record)
        self.count += 1

    def flush(self) -> None:
        """Let others see all records: first the records, then that they are there.

        Raises:
            OSError: there is no room.
        """
        if self._offsets:
            write_all(self._file, self._pending)
            write_all(self._index, self._offsets)
            self._pending, self._offsets = bytearray(), bytearray()

    def close(self) -> None:
        """Close both files."""
        self._file.close()
        self._index.close()


def write_all(file: BinaryIO | RawIOBase, data: bytes | bytearray) -> None:
    """Write all of `data`: a file that is not buffered may take less at once.

    Raises:
        OSError: there is no room.
    """
    written = file.write(data) or 0
    while written < len(data):
        written += file.write(memoryview(data)[written:]) or 0


class CachedFileReader:
    """Reads anywhere in a file that grows, a piece at a time."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("rb", buffering=0)
        self._start = 0
        self._data = b""

    @property
    def size(self) -> int:
        """Bytes that are there by now."""
        return os.fstat(self._file.fileno()).st_size

    def read(self, start: int, size: int) -> bytes:
        """Read; fewer bytes than asked for only where the file ends."""
        at = start - self._start
        if at < 0 or at + size > len(self._data):
            self._file.seek(start)
            self._start, self._data, at = start, self._file.read(max(size, _READ_AHEAD)), 0
            while len(self._data) < size and (more := self._file.read(size - len(self._data))):
                self._data += more
        return self._data[at : at + size]

    def discard_cache(self) -> None:
        """Read anew what was read before."""
        self._data = b""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class AppendLogReader:
    """The records of an `AppendLogWriter`, by number from 0; also a context manager that closes them."""

    def __init__(self, path: Path) -> None:
        self._records = CachedFileReader(path)
        self._index = CachedFileReader(_index_path(path))
        self._count = 0

    def __enter__(self) -> AppendLogReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """How many there were when `refresh` was called last."""
        return self._count

    def refresh(self) -> int:
        """Look how many there are by now."""
        self._count = self._index.size // _OFFSET.size
        return self._count

    def offset_of(self, number: int) -> int:
        """Return the offset at which a record begins.

        Raises:
            IndexError: there is no such record.
        """
        data = self._index.read(number * _OFFSET.size, _OFFSET.size) if number >= 0 else b""
        if len(data) < _OFFSET.size:
            raise IndexError(number)
        (offset,) = _OFFSET.unpack(data)
        return int(offset)

    def read(self, start: int, size: int) -> bytes:
        """Read bytes of the records."""
        return self._records.read(start, size)

    def close(self) -> None:
        """Close both files."""
        self._records.close()
        self._index.close()


def _index_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.index")
