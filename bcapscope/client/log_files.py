"""Log files of bounded size: one or several per day, to which any number of processes append lines."""

from __future__ import annotations

import errno
import os
import re
from contextlib import suppress
from datetime import datetime
from pathlib import Path

MAX_FILE_SIZE = 16 << 20
"""Size limit of a log file in bytes. Beyond this size, the next file of the day begins."""

MAX_TOTAL_SIZE = 128 << 20
"""Size limit of all log files together in bytes. The oldest files are deleted when a new file begins."""


class LogFiles:
    """Appends lines to ``<name>-<date>.jsonl``, then ``<name>-<date>.2.jsonl`` and so on.

    `path` is the file that holds the last line, or the folder before the first line.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        max_file_size: int = MAX_FILE_SIZE,
        max_total_size: int = MAX_TOTAL_SIZE,
    ) -> None:
        """Set up the log files; the first line creates the folder."""
        self.path = folder
        self._folder = folder
        self._name = name
        self._max_file_size = max_file_size
        self._max_total_size = max_total_size
        self._is_torn = False

    def append(self, line: bytes) -> None:
        """Append a line with a single write, so that other processes can append to the same file.

        Raises OSError if the line was not written, or only in part.
        """
        self.path = self._current(datetime.now().strftime("%Y-%m-%d"))
        data = b"\n" + line if self._is_torn else line
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
        descriptor = os.open(self.path, flags, 0o644)
        try:
            written = os.write(descriptor, data)
        finally:
            os.close(descriptor)
        self._is_torn = written < len(data)
        if self._is_torn:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _current(self, day: str) -> Path:
        path = self.path
        if path.parent != self._folder or not path.name.startswith(f"{self._name}-{day}"):
            self._folder.mkdir(parents=True, exist_ok=True)
            numbers = map(_number_of, self._folder.glob(f"{self._name}-{day}*"))
            path = self._numbered_path(day, max(numbers, default=1))
        try:
            size = path.stat().st_size
        except FileNotFoundError:
            self._folder.mkdir(parents=True, exist_ok=True)  # deleted while bcapscope runs
            self._delete_oldest()
            return path
        if size < self._max_file_size:
            return path
        self.path = self._numbered_path(day, _number_of(path) + 1)
        return self._current(day)

    def _numbered_path(self, day: str, number: int) -> Path:
        return self._folder / f"{self._name}-{day}{f'.{number}' if number > 1 else ''}.jsonl"

    def _delete_oldest(self) -> None:
        """Delete the oldest files until a new file fits into the limit, or a file cannot be deleted."""
        with suppress(OSError):
            found = [(path.stat(), path) for path in self._folder.glob(f"{self._name}-*.jsonl")]
            left = sum(stat.st_size for stat, _ in found) + self._max_file_size
            for stat, path in sorted(found, key=lambda each: (each[0].st_mtime_ns, _number_of(each[1]))):
                if left <= self._max_total_size:
                    return
                path.unlink()
                left -= stat.st_size


def _number_of(path: Path) -> int:
    found = re.search(r"\.(\d{1,6})\.jsonl$", path.name)
    return int(found[1]) if found else 1
