"""Open capture files, detect their format, and find the captures in folders."""

from __future__ import annotations

import io
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from bcapscope.capture.byte_source import GZIP_MAGIC, ByteSource, ChunkReader, GzipReader
from bcapscope.capture.packet import Packet
from bcapscope.capture.pcap import MAGICS, read_pcap
from bcapscope.capture.pcapng import MAGIC, read_pcapng
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason

if TYPE_CHECKING:
    from threading import Event

POLL_INTERVAL = 0.02
"""Time in s between two checks for new data. Not every system can report that a file has grown."""


_READERS = {**dict.fromkeys(MAGICS, read_pcap), MAGIC: read_pcapng}
_OTHER_FORMATS = {
    b"\xa1\xb2\xcd\x34": "kuznetzov",
    b"\x34\xcd\xb2\xa1": "kuznetzov",
    b"snoo": "snoop",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\xfd7zX": "xz",
    b"BZh9": "bzip2",
    b"\x04\x22\x4d\x18": "lz4",
}


class CaptureFile:
    """A capture that can be read only once. `position` is the number of bytes read so far. `size` is the
    file's size on disk in bytes; None for a stream without a size, such as a pipe.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._read: ChunkReader = getattr(stream, "read1", stream.read)
        self.size = _file_size(stream)
        self.position = 0

    def __enter__(self) -> CaptureFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._stream.close()

    def __iter__(self) -> Iterator[Packet]:
        """Yield each packet as soon as it has been read. If the capture is damaged, yield all packets before
        the damage, then raise CaptureError.
        """
        source = _open_source(self._read_chunk)
        return _reader_for(source.data)(source)

    def _read_chunk(self, size: int) -> bytes:
        try:
            data = self._read(size)
        except OSError as error:
            raise CaptureError(
                Message("capture.cannot-read", reason=os_reason(error)), self.position
            ) from error
        self.position += len(data)
        return data


class _GrowingFile(io.RawIOBase):
    """A file whose `read` waits for more bytes, and returns b"" only when the capture has ended."""

    def __init__(self, file: io.FileIO, ended: Event, on_idle: Callable[[], None]) -> None:
        self._file = file
        self._ended = ended
        self._on_idle = on_idle

    def read(self, size: int = -1) -> bytes:
        while True:
            # If this check came after the read, bytes written between read and check would be lost.
            over = self._ended.is_set()
            data = self._file.read(size)
            if data or over:
                return data or b""
            self._on_idle()
            self._ended.wait(POLL_INTERVAL)

    def close(self) -> None:
        self._file.close()
        super().close()


def open_capture(path: str | os.PathLike[str]) -> CaptureFile:
    """Open a capture, plain or compressed with gzip, or raise CaptureError. Detect the format by content."""
    return CaptureFile(_open_file(path))


def follow_capture(path: Path, ended: Event, on_idle: Callable[[], None]) -> CaptureFile:
    """Open a capture that another program is still writing, or raise CaptureError.

    At the end of the file, the reader calls `on_idle` and waits for new data until the caller sets `ended`.
    """
    return CaptureFile(cast(BinaryIO, _GrowingFile(_open_file(path), ended, on_idle)))


def _open_file(path: str | os.PathLike[str]) -> io.FileIO:
    try:
        return Path(path).open("rb", buffering=0)
    except OSError as error:
        raise CaptureError(Message("capture.cannot-open", reason=os_reason(error))) from error


def expand_folders(paths: Sequence[str], on_problem: Callable[[str, CaptureError], None]) -> Iterator[str]:
    """Yield the paths. Replace each folder by the captures in this folder, except those that `paths` also
    names. `on_problem` receives each folder that has no capture or cannot be read.
    """
    named = {os.path.realpath(path) for path in paths}
    for path in paths:
        if not os.path.isdir(path):
            yield path
            continue
        try:
            found = _captures_in(path)
        except CaptureError as error:
            on_problem(path, error)
            continue
        yield from (each for each in found if os.path.realpath(each) not in named)


def _captures_in(folder: str) -> list[str]:
    """Return a folder's captures, sorted by name. Ignore hidden files: rsync hides incomplete files."""
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise CaptureError(Message("capture.cannot-open", reason=os_reason(error))) from error
    paths = [os.path.join(folder, name) for name in names if not name.startswith(".")]
    found = [path for path in paths if Path(path).is_file() and _is_capture(path)]
    if not found:
        raise CaptureError(Message("capture.folder-without-captures"))
    return found


def _is_capture(path: str) -> bool:
    """Return whether a file is a capture. For a file that cannot be read, return True: bcapscope
    reports the error later, when it reads the captures.
    """
    try:
        with Path(path).open("rb", buffering=0) as stream:
            head = _open_source(stream.read).data[:4]
    except OSError:
        return True
    except CaptureError:
        return False
    return head in _READERS


def _open_source(read: ChunkReader) -> ByteSource:
    """Open a stream, and read at least its first four bytes after decompression."""
    source = ByteSource(read)
    if source.ensure_bytes(2) and source.data.startswith(GZIP_MAGIC):
        source = ByteSource(GzipReader(read, source.data))
    source.ensure_bytes(4)
    return source


def _reader_for(head: bytes) -> Callable[[ByteSource], Iterator[Packet]]:
    magic = head[:4]
    if magic in _READERS:
        return _READERS[magic]
    if not head:
        raise CaptureError(Message("capture.empty"), 0)
    if magic in _OTHER_FORMATS:
        raise CaptureError(Message(f"capture.other-format.{_OTHER_FORMATS[magic]}"), 0)
    raise CaptureError(Message("capture.no-capture", bytes=magic.hex(" ")), 0)


def _file_size(stream: BinaryIO) -> int | None:
    try:
        status = os.fstat(stream.fileno())
    except OSError:
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None
