"""A capture that is still being written, read as it grows."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import BinaryIO, cast

from bcapscope.capture.capture_file import CaptureFile
from bcapscope.errors import CaptureError

POLL_INTERVAL = 0.02
"""Seconds between two looks whether there is more, too short to be seen; no call that all systems have tells
that a file has grown."""


class _GrowingFile(io.RawIOBase):
    """Gives what there is, and where the file ends waits for more."""

    def __init__(self, file: io.FileIO, ended: Event, on_idle: Callable[[], None]) -> None:
        self._file = file
        self._ended = ended
        self._on_idle = on_idle

    def read(self, size: int = -1) -> bytes:
        """Return up to `size` bytes; none only when the capture has ended."""
        while True:
            over = self._ended.is_set()  # asked first: what was written until then is still read
            data = self._file.read(size)
            if data or over:
                return data or b""
            self._on_idle()
            self._ended.wait(POLL_INTERVAL)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def follow_capture(path: Path, ended: Event, on_idle: Callable[[], None]) -> CaptureFile:
    """Open a capture that somebody is still writing.

    Args:
        path: the file.
        ended: is set when nothing more will be written.
        on_idle: is called whenever there is nothing to read.

    Raises:
        CaptureError: the file cannot be opened.
    """
    try:
        file = io.FileIO(path)
    except OSError as error:
        raise CaptureError(f"cannot be opened: {error.strerror}") from error
    return CaptureFile(cast(BinaryIO, _GrowingFile(file, ended, on_idle)))
