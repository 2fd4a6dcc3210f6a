"""Log files: one process appends records while other processes read records at any position."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import BinaryIO, Protocol

_READ_AHEAD = 64 * 1024
"""Bytes per read. A screen shows adjacent records, so one read often covers all of them."""

_OFFSET = struct.Struct("<Q")


class AppendLogWriter:
    """Appends each record to a file, and the record's end offset to an index file."""

    def __init__(self, path: Path) -> None:
        """Create `path` and an index file beside it. Raises FileExistsError if either file exists."""
        self._file: BinaryIO = path.open("xb", buffering=0)
        self._index: BinaryIO = _index_path(path).open("xb", buffering=0)
        self._pending = bytearray()
        self._offsets = bytearray()
        self._end = 0
        self.count = 0

    def add(self, record: bytes) -> None:
        self._pending += record
        self._end += len(record)
        self._offsets += _OFFSET.pack(self._end)
        self.count += 1

    def flush(self) -> None:
        """Write the pending records before their index entries, so that readers see only whole records."""
        if self._offsets:
            write_all(self._file, self._pending)
            write_all(self._index, self._offsets)
            self._pending, self._offsets = bytearray(), bytearray()

    def close(self) -> None:
        self._file.close()
        self._index.close()


class ByteSink(Protocol):
    def write(self, data: bytes | bytearray | memoryview, /) -> int | None: ...


def write_all(file: ByteSink, data: bytes | bytearray) -> None:
    """Write all of `data`, or raise OSError. A single `write` to an unbuffered file may write only a part."""
    written = file.write(data) or 0
    while written < len(data):
        written += file.write(memoryview(data)[written:]) or 0


class CachedFileReader:
    """Reads a growing file at any position, and caches the bytes of the latest read."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("rb", buffering=0)
        self._start = 0
        self._data = b""

    @property
    def size(self) -> int:
        return os.fstat(self._file.fileno()).st_size

    def read(self, start: int, size: int) -> bytes:
        """Return `size` bytes from offset `start`, or fewer bytes at the end of the file."""
        at = start - self._start
        if at < 0 or at + size > len(self._data):
            self._file.seek(start)
            self._start, self._data, at = start, self._file.read(max(size, _READ_AHEAD)), 0
            while len(self._data) < size and (more := self._file.read(size - len(self._data))):
                self._data += more
        return self._data[at : at + size]

    def discard_cache(self) -> None:
        self._data = b""

    def close(self) -> None:
        self._file.close()


class AppendLogReader:
    """Reads the records of an `AppendLogWriter`. `len()` is the number of records at the latest `refresh`."""

    def __init__(self, path: Path) -> None:
        self._records = CachedFileReader(path)
        self._index = CachedFileReader(_index_path(path))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def refresh(self) -> int:
        self._count = self._index.size // _OFFSET.size
        return self._count

    def read_record(self, number: int) -> bytes:
        """Return a record by its number, from 0. Raises IndexError if there is no such record."""
        first, count = max(number - 1, 0), 2 if number else 1
        ends = self._index.read(first * _OFFSET.size, count * _OFFSET.size) if number >= 0 else b""
        if len(ends) < count * _OFFSET.size:
            raise IndexError(number)
        stop = int.from_bytes(ends[-_OFFSET.size :], "little")
        start = int.from_bytes(ends[: _OFFSET.size], "little") if number else 0
        return self._records.read(start, stop - start)

    def close(self) -> None:
        self._records.close()
        self._index.close()


def _index_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.index")
