"""A context manager that records b-CAP traffic, and shows its calls and findings."""

from __future__ import annotations

from abc import abstractmethod
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.testing.threaded_context import ThreadedContext

if TYPE_CHECKING:
    from bcapscope.analysis.finding import Finding
    from bcapscope.testing.recorded_traffic import RecordedTraffic
    from bcapscope.traffic.call import Call

LOOPBACK = "127.0.0.1"


class RecordingContext(ThreadedContext):
    """Records the traffic of a `with` block in the file `record`. If `record` is None, the file is temporary.

    Attributes:
        host: Address for clients.
        port: Port for clients, UDP and TCP; 0 before the `with` block begins.
        recording: Capture of the traffic. A temporary file exists until the block ends.
    """

    def __init__(self, record: str | Path | None) -> None:
        self.host: str = LOOPBACK
        self.port: int = 0
        self.recording: Path = Path() if record is None else Path(record)
        self._is_temporary = record is None
        self._stack = ExitStack()
        self._is_running = False
        self._last_traffic: RecordedTraffic | None = None

    @property
    def calls(self) -> list[Call]:
        """Calls in the traffic so far, including calls without a reply."""
        return [call for call, _ in self.traffic().calls]

    @property
    def findings(self) -> list[Finding]:
        """What `bcapscope diagnose` finds in the traffic so far, root cause first."""
        return self.traffic().findings

    def traffic(self) -> RecordedTraffic:
        """Return the traffic of the `with` block so far. After the end of the block, return the traffic of
        the whole block.

        Raises:
            InputError: The block has not begun.
        """
        if self._is_running:
            self._write_recording()
            return self._read_recording()
        if self._last_traffic is None:
            raise InputError(Message("testing.not-entered"))
        return self._last_traffic

    @abstractmethod
    def _start(self, opened: ExitStack) -> int:
        """Start to serve and record, and return the port. The exit stack `opened` is closed after `_stop` has
        run.
        """

    @abstractmethod
    def _stop(self) -> None:
        """Stop serving clients, and complete the recording."""

    @abstractmethod
    def _write_recording(self) -> None:
        """Write all traffic so far to the file of the recording."""

    @abstractmethod
    def _server_ports(self) -> frozenset[int]:
        """Return the ports of the controllers in the recording."""

    def _open(self) -> None:
        with ExitStack() as opened:
            if self._is_temporary:
                folder = opened.enter_context(TemporaryDirectory(prefix="bcapscope-"))
                self.recording = Path(folder, "traffic.pcapng")
            self.port = self._start(opened)
            self._last_traffic, self._is_running = None, True
            self._stack = opened.pop_all()

    def _close(self) -> None:
        with self._stack:
            self._is_running = False
            self._stop()
            self._last_traffic = self._read_recording()

    def _read_recording(self) -> RecordedTraffic:
        from bcapscope.testing.recorded_traffic import RecordedTraffic  # imports NumPy

        return RecordedTraffic(self.recording, self._server_ports())
