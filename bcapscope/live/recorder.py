"""The recorder for long-running programs: proxy, simulator, Tester and live capture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bcapscope.capture.rotating_recording import RotatingRecording, RotationLimits
from bcapscope.errors import FileWriteError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.render.escape import printable


class Recorder:
    """A recording that raises no exception while recording. If the disk fails, the recorder warns once and
    drops packets.

    Attributes:
        packets: Adding a packet to this object never raises an exception; `flush` writes the packets.
        is_complete: Whether all packets could be written so far.
    """

    def __init__(
        self, path: Path, warn: Callable[[Message], None], ring: RotationLimits | None = None
    ) -> None:
        """Create the file. In a ring, each file name contains a number and a time. `warn` must not block.

        Raises FileWriteError if the file exists already, or cannot be written.
        """
        try:
            self.files = RotatingRecording(path, ring)
        except OSError as error:
            raise FileWriteError(path, os_reason(error)) from None
        self.packets = self.files.recording
        self.is_ring = ring is not None
        self.is_complete = True
        self.name = printable(str(path))
        self.warn = warn
        self._has_warned_full = False

    def begin_packet(self) -> bool:
        """Call this before you add a packet to a ring of files. Return whether a new file began."""
        try:
            return self.is_complete and self.files.rotate_if_full()
        except OSError as error:
            self._give_up(error)
            return False

    def flush(self) -> None:
        if not self.is_complete:
            return
        try:
            self.files.flush()
        except OSError as error:
            self._give_up(error)
            return
        if self.files.files_freed and not self._has_warned_full:
            self._has_warned_full = True
            self.warn(Message("recording.disk-full", name=self.name))

    def close(self) -> None:
        self.flush()
        self.files.close()

    def _give_up(self, error: OSError) -> None:
        self.is_complete = False
        self.files.close()
        self.warn(Message("recording.stopped", name=self.name, reason=os_reason(error)))
