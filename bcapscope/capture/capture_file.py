"""Open capture files and detect their format."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, TypeAlias

from bcapscope.capture.byte_source import GZIP_MAGIC, ByteSource, ChunkReader, GzipReader
from bcapscope.capture.packet import Packet
from bcapscope.capture.pcap import MAGICS, read_pcap
from bcapscope.capture.pcapng import MAGIC, read_pcapng
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason

_FormatReader: TypeAlias = Callable[[ByteSource], Iterator[Packet]]

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
    """A capture that is read once, from beginning to end. The context manager closes the file.

    Attributes:
        size: Size of the file on disk in bytes; None for a stream without a size, such as a pipe.
        position: Number of bytes of the file read so far.
    """

    def __init__(self, stream: BinaryIO) -> None:
        """Read from a binary stream. Packets from a pipe are yielded as soon as they arrive."""
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
        """Yield the packets.

        Raises:
            CaptureError: The stream is not a capture, or is damaged or incomplete. Before this error, the
                iterator yields all packets that precede the damage.
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


def open_capture(path: str | os.PathLike[str]) -> CaptureFile:
    """Open a capture file, which may be compressed with gzip. The content of the file shows its format.

    Raises:
        CaptureError: The file cannot be opened.
    """
    try:
        return CaptureFile(Path(path).open("rb", buffering=0))
    except OSError as error:
        raise CaptureError(Message("capture.cannot-open", reason=os_reason(error))) from error


def is_capture(path: str) -> bool:
    """Return whether a file begins like a readable capture. The file may be compressed with gzip.

    A file that cannot be opened counts as a capture, so that the user gets an error.
    """
    try:
        with Path(path).open("rb", buffering=0) as stream:
            head = _open_source(stream.read).data[:4]
    except OSError:
        return True
    except CaptureError:
        return False
    return head in MAGICS or head == MAGIC


def _open_source(read: ChunkReader) -> ByteSource:
    """Read the first four bytes or more, after decompression if the stream is compressed."""
    source = ByteSource(read)
    if source.ensure_bytes(2) and source.data.startswith(GZIP_MAGIC):
        source = ByteSource(GzipReader(read, source.data))
    source.ensure_bytes(4)
    return source


def _reader_for(head: bytes) -> _FormatReader:
    magic = head[:4]
    if magic in MAGICS:
        return read_pcap
    if magic == MAGIC:
        return read_pcapng
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
