"""Read a capture while another program still writes it."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import BinaryIO, cast

from bcapscope.capture.capture_file import CaptureFile
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason

POLL_INTERVAL = 0.02
"""Time in s between two checks for new data. Users do not notice such a short time. Polling is necessary,
because not every operating system can report that a file has grown.
"""


class _GrowingFile(io.RawIOBase):
    """A file whose `read` waits for more bytes at the end of the file, until the capture has ended."""

    def __init__(self, file: io.FileIO, ended: Event, on_idle: Callable[[], None]) -> None:
        self._file = file
        self._ended = ended
        self._on_idle = on_idle

    def read(self, size: int = -1) -> bytes:
        """Return up to `size` bytes; b"" only when the capture has ended."""
        while True:
            over = self._ended.is_set()  # check this before the read, so that no byte is missed
            data = self._file.read(size)
            if data or over:
                return data or b""
            self._on_idle()
            self._ended.wait(POLL_INTERVAL)

    def close(self) -> None:
        self._file.close()
        super().close()


def follow_capture(path: Path, ended: Event, on_idle: Callable[[], None]) -> CaptureFile:
    """Open a capture that another program still writes, until the caller sets `ended`.

    The reader calls `on_idle` whenever it waits for new data.

    Raises:
        CaptureError: The file cannot be opened.
    """
    try:
        file = io.FileIO(path)
    except OSError as error:
        raise CaptureError(Message("capture.cannot-open", reason=os_reason(error))) from error
    return CaptureFile(cast(BinaryIO, _GrowingFile(file, ended, on_idle)))
