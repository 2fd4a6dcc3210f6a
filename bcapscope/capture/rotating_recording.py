"""A recording in one file, or in a ring of files: when the ring is full, the oldest file is removed."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import stat
import sys
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bcapscope.capture.append_log import write_all
from bcapscope.capture.pcapng_writer import is_packet_block
from bcapscope.capture.socket_recording import SocketRecording
from bcapscope.messages import Message

_UNITS = {"k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
_TIMES = {"s": 1, "min": 60, "h": 3600, "d": 86400}
_ROTATION = re.compile(r"(\d{1,6})x(.+)", re.ASCII)
_SIZE = re.compile(r"(\d{1,12})([kMGT]?)B", re.ASCII)
_TIME = re.compile(r"(\d{1,8})(s|min|h|d)", re.ASCII)
_SMALLEST = 10_000
"""Smallest size limit, in bytes, that users can set for the files of a ring."""

_BLOCK_OVERHEAD = 512
"""Bytes of memory that a pending block needs in addition to its data."""

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})


@dataclass(frozen=True, slots=True)
class RotationLimits:
    """Limits of a recording in a ring of files.

    Attributes:
        files: Maximum number of files in the ring.
        size: Size in bytes at which a file is full; 0 for no limit.
        seconds: Time in s from a file's first packet until the file is full; 0 for no limit.
    """

    files: int
    size: int = 0
    seconds: int = 0


def parse_rotation(text: str) -> RotationLimits:
    """Parse a notation such as ``10x100MB``, ``24x1h`` or ``24x1h,500MB``, or raise ValueError."""
    found = _ROTATION.fullmatch(text)
    if found is None or int(found[1]) < 2:
        raise ValueError(
            f"{text!r}: expected a ring of at least 2 files, such as 10x100MB, 24x1h or 24x1h,500MB"
        )
    size = seconds = 0
    for part in found[2].split(","):
        as_size, as_time = _SIZE.fullmatch(part), _TIME.fullmatch(part)
        if as_size is not None and not size:
            size = int(as_size[1]) * _UNITS.get(as_size[2], 1)
        elif as_time is not None and not seconds:
            seconds = int(as_time[1]) * _TIMES[as_time[2]]
        else:
            raise ValueError(f"{part!r}: expected at most one size such as 100MB and one time such as 1h")
    if (size and size < _SMALLEST) or not size + seconds:
        raise ValueError(f"{text!r}: each file must hold at least 10kB and at least one second")
    return RotationLimits(int(found[1]), size, seconds)


class RotatingRecording:
    """Writes a recording to one file or to a ring of files. Blocks are pending until `flush` writes them.

    One thread may add packets while another thread calls `flush`, but only if the recording is one file. The
    caller calls `rotate_if_full` before each packet.

    On a full disk, a ring removes its oldest file and continues. Each file takes at most half of the disk
    space that was free when the file began, so the ring always has an older file to remove.

    Attributes:
        recording: Writer of packets to the current file.
        files_freed: Number of files removed because the disk was full.
    """

    def __init__(self, path: Path, limits: RotationLimits | None = None) -> None:
        """Create the first file, or raise OSError. Without `limits`, the recording has only this file.

        `path` must not exist yet, or must be a named pipe that another program reads. The names of a ring's
        files contain the number of the file, and the date and time at which the file began.
        """
        self._path = path
        self._limits = limits
        self._pending: list[bytes] = []
        self._added = self._taken = 0
        self._files: deque[Path] = deque()
        self._file_count = 0
        self.files_freed = 0
        self._is_closed = False
        self._open_next_file()
        self.recording = SocketRecording(self)
        self._write_file_header()

    def write(self, data: bytes | bytearray | memoryview, /) -> int:
        """Add whole pcapng blocks, which the next `flush` writes. After `close`, added blocks are dropped."""
        if not self._is_closed:
            self._pending.append(bytes(data))
            self._added += len(data)
        return len(data)

    @property
    def bytes_pending(self) -> int:
        return self._added - self._taken + len(self._pending) * _BLOCK_OVERHEAD

    @property
    def packets_pending(self) -> int:
        """Number of packets in the pending blocks; correct only if `write` got a single block each time."""
        return sum(map(is_packet_block, self._pending.copy()))

    def flush(self) -> None:
        """Write all pending blocks. After OSError, the file holds only the blocks of earlier flushes."""
        count = len(self._pending)
        if not count:
            return
        data = b"".join(self._pending[:count])
        try:
            while not self._try_write(data):
                pass
        finally:
            del self._pending[:count]
            self._taken += len(data)
        if self.is_empty:
            self._first_packet_at = time.monotonic()
        self._size += len(data)

    def _try_write(self, data: bytes) -> bool:
        """Write all of `data`. If the disk is full, write nothing, remove the ring's oldest file and return
        False. Raise OSError if the disk is full but the ring has no older file, or if writing fails for a
        reason other than a full disk.
        """
        try:
            write_all(self._file, data)
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(self._size)
                self._file.seek(self._size)
            if not self._free_space(error, kept=1):
                raise
            return False
        return True

    def _free_space(self, error: OSError, kept: int) -> bool:
        """If the disk is full and more than `kept` files exist, remove the ring's oldest file and return
        True.
        """
        if self._limits is None or error.errno not in _DISK_FULL or len(self._files) <= kept:
            return False
        self.files_freed += 1
        self._remove_oldest()
        return True

    def _remove_oldest(self) -> None:
        with suppress(OSError):  # `unlink` fails if the user has moved the file
            self._files.popleft().unlink()

    def rotate_if_full(self) -> bool:
        """Begin the ring's next file if the current file is full; return whether a new file began."""
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
        """Close the file. Blocks that were added after the last `flush` are lost."""
        self._drop_pending()
        self._is_closed = True
        self._file.close()

    def _drop_pending(self) -> None:
        self._pending.clear()
        self._taken = self._added

    @property
    def is_empty(self) -> bool:
        return self._size <= self._header_size

    @property
    def paths(self) -> tuple[Path, ...]:
        """The existing files, oldest first."""
        return tuple(self._files)

    def _is_full(self, limits: RotationLimits) -> bool:
        size = self._size + self._added - self._taken
        if size <= self._header_size:
            return False
        too_large = (limits.size and size >= limits.size) or size >= self._size_limit
        return bool(
            too_large or (limits.seconds and time.monotonic() - self._first_packet_at >= limits.seconds)
        )

    def _open_next_file(self) -> None:
        self._drop_pending()
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
        if self._limits is None and is_named_pipe(path):
            return _open_named_pipe(path)
        while True:
            try:
                return path.open("xb", buffering=0)
            except OSError as error:
                if not self._free_space(error, kept=0):
                    raise

    def _write_file_header(self) -> None:
        """Write the file header at once, so that other programs can open the file before the first packet."""
        self.flush()
        self._header_size = self._size


def is_named_pipe(path: Path) -> bool:
    """Return whether `path` is a named pipe. On Windows, only the text of `path` is checked: `stat` would
    open the pipe, and Wireshark's pipe can be opened only once.
    """
    if sys.platform == "win32":
        return str(path).startswith("\\\\.\\pipe\\")
    try:
        return stat.S_ISFIFO(path.stat().st_mode)
    except OSError:
        return False


def _open_named_pipe(path: Path) -> io.FileIO:
    if sys.platform == "win32":
        return io.FileIO(os.open(path, os.O_WRONLY | os.O_BINARY), "wb")
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        raise OSError(Message("recording.no-reader")) if error.errno == errno.ENXIO else error from None
    os.set_blocking(descriptor, True)
    return io.FileIO(descriptor, "wb")


def _free_bytes(path: Path) -> int:
    try:
        return shutil.disk_usage(path.parent).free
    except OSError:
        return 1 << 62
