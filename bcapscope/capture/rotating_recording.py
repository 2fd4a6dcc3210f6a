"""A recording in one file, or in a ring of files of which the oldest are removed."""

from __future__ import annotations

import errno
import io
import re
import shutil
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bcapscope.capture.socket_recording import SocketRecording

_UNITS = {"k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
_TIMES = {"s": 1, "min": 60, "h": 3600, "d": 86400}
_ROTATION = re.compile(r"(\d{1,6})x(.+)", re.ASCII)
_SIZE = re.compile(r"(\d{1,12})([kMGT]?)B", re.ASCII)
_TIME = re.compile(r"(\d{1,8})(s|min|h|d)", re.ASCII)
_SMALLEST = 10_000
"""Bytes; the least that a file of a ring may be limited to."""

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})


@dataclass(frozen=True, slots=True)
class RotationLimits:
    """How large a ring of files becomes.

    Attributes:
        files: how many there are at most.
        size: bytes after which the next one begins, with the packet that comes then; 0 for any size.
        seconds: after which the next one begins; 0 for any time.
    """

    files: int
    size: int = 0
    seconds: int = 0


def parse_rotation(text: str) -> RotationLimits:
    """Read a notation such as ``10x100MB``, ``24x1h`` or ``24x1h,500MB``.

    Raises:
        ValueError: it makes no sense; the message says what.
    """
    found = _ROTATION.fullmatch(text)
    if found is None or int(found[1]) < 2:
        raise ValueError(
            f"{text!r}: a ring is written as 10x100MB, 24x1h or 24x1h,500MB, of 2 files at least"
        )
    size = seconds = 0
    for part in found[2].split(","):
        as_size, as_time = _SIZE.fullmatch(part), _TIME.fullmatch(part)
        if as_size is not None and not size:
            size = int(as_size[1]) * _UNITS.get(as_size[2], 1)
        elif as_time is not None and not seconds:
            seconds = int(as_time[1]) * _TIMES[as_time[2]]
        else:
            raise ValueError(
                f"{part!r} is no size, such as 100MB, and no time, such as 1h, or is there twice"
            )
    if (size and size < _SMALLEST) or not size + seconds:
        raise ValueError(f"{text!r}: a file holds 10kB and a second at least")
    return RotationLimits(int(found[1]), size, seconds)


class RotatingRecording(io.RawIOBase):
    """The files of a recording; `flush` writes everything in one piece.

    Call `rotate_if_full` before each packet: it begins a ring's next file only for a packet that exists, so
    no file is empty and no old file is removed in vain.

    On a full disk, a ring removes its oldest file and goes on. So that an older file exists by then, no file
    takes more than half of the space that was free when it began.

    Attributes:
        recording: writes packets to them.
        files_freed: files that were removed because the disk was full.
    """

    def __init__(self, path: Path, limits: RotationLimits | None = None) -> None:
        """Begin.

        Args:
            path: the file, which must not exist; those of a ring are named after it, with their number and
                the time of day when they began.
            limits: make it a ring.

        Raises:
            OSError: it cannot be written.
        """
        super().__init__()
        self._path = path
        self._limits = limits
        self._pending: list[bytes] = []
        self._files: deque[Path] = deque()
        self._file_count = 0
        self.files_freed = 0
        try:
            self._open_next_file()
        except OSError:
            super().close()  # Python calls `close` otherwise, and there is no file to close
            raise
        self.recording = SocketRecording(self)
        self._write_file_header()

    def writable(self) -> bool:
        """Say so."""
        return True

    def write(self, data: bytes, /) -> int:  # type: ignore[override]  # whole blocks, which are bytes
        """Take whole blocks of the capture."""
        self._pending.append(data)
        self._pending_size += len(data)
        return len(data)

    def flush(self) -> None:
        """Put what was written into the file.

        Raises:
            OSError: there is no room, or the like; the file ends with what was in it before.
        """
        if not self._pending:
            return
        data, self._pending, self._pending_size = b"".join(self._pending), [], 0
        while not self._try_write(data):
            pass
        if self._size <= self._header_size:
            self._first_packet_at = time.monotonic()
        self._size += len(data)

    def _try_write(self, data: bytes) -> bool:
        """Write all of `data` or nothing; return False if the disk was full and a file was removed for it.

        Raises:
            OSError: the file cannot be written, and there is no file to remove.
        """
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(self._size)
                self._file.seek(self._size)
            if not self._free_space(error, kept=1):
                raise
            return False
        return True

    def _free_space(self, error: OSError, kept: int) -> bool:
        """Remove the oldest file of a ring after `error`, but not the last `kept`; return whether it did."""
        if self._limits is None or error.errno not in _DISK_FULL or len(self._files) <= kept:
            return False
        self.files_freed += 1
        self._remove_oldest()
        return True

    def _remove_oldest(self) -> None:
        with suppress(OSError):  # somebody else has moved it
            self._files.popleft().unlink()

    def rotate_if_full(self) -> bool:
        """Go on with the next file where it is time to; tell whether it was.

        Raises:
            OSError: it cannot be written.
        """
        bounds = self._limits
        if bounds is None or not self._is_full(bounds):
            return False
        self.flush()
        self._file.close()
        while len(self._files) >= bounds.files:
            self._remove_oldest()
        self._open_next_file()
        self.recording.continue_in(self)
        self._write_file_header()
        return True

    def close(self) -> None:
        """Close the file; what was not flushed is lost."""
        self._pending.clear()
        super().close()
        self._file.close()

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files that there are, the oldest first."""
        return tuple(self._files)

    def _is_full(self, limits: RotationLimits) -> bool:
        size = self._size + self._pending_size
        if size <= self._header_size:
            return False
        too_large = (limits.size and size >= limits.size) or size >= self._size_limit
        return bool(
            too_large or (limits.seconds and time.monotonic() - self._first_packet_at >= limits.seconds)
        )

    def _open_next_file(self) -> None:
        self._pending.clear()
        self._pending_size = 0
        self._file_count += 1
        path = self._path
        if self._limits is not None:
            name = f"{path.stem}_{self._file_count:05}_{time.strftime('%Y%m%d%H%M%S')}{path.suffix}"
            path = path.with_name(name)
        self._file = self._create_file(path)
        self._files.append(path)
        self._size = self._header_size = 0
        self._size_limit = max(_SMALLEST, _free_bytes(path) // 2)

    def _create_file(self, path: Path) -> io.FileIO:
        while True:
            try:
                return path.open("xb", buffering=0)
            except OSError as error:
                if not self._free_space(error, kept=0):
                    raise

    def _write_file_header(self) -> None:
        """Write what stands before all packets, so that the file can be read from its first moment."""
        self.flush()
        self._header_size = self._size


def _free_bytes(path: Path) -> int:
    """Return the free bytes on a file's disk, or a large number if the system does not report them."""
    try:
        return shutil.disk_usage(path.parent).free
    except OSError:
        return 1 << 62
