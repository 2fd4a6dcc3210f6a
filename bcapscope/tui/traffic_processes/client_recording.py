"""Records the packets of bcapscope's own client as a capture that can be shown while it grows."""

from __future__ import annotations

import threading
from pathlib import Path

from bcapscope.capture.socket_recording import SocketRecording
from bcapscope.traffic.observation import Observation, Transport


class ClientRecording:
    """Writes observations; the client continues even if writing fails."""

    def __init__(self, path: Path) -> None:
        """Create a new capture.

        Raises:
            OSError: The file exists already or cannot be created.
        """
        self._file = path.open("xb", buffering=0)
        self._recording: SocketRecording | None = SocketRecording(self._file)
        self._lock = threading.Lock()

    def write_observation(self, observation: Observation) -> None:
        """Write an observation; any thread may call this."""
        flow = observation.flow
        ends = (flow.src.host, flow.src.port), (flow.dst.host, flow.dst.port)
        with self._lock:
            recording = self._recording
            if recording is None:
                return
            write = (
                recording.write_segment
                if flow.conversation.transport is Transport.TCP
                else recording.write_datagram
            )
            try:
                write(*ends, observation.item.raw, observation.time)
            except OSError:
                self._recording = None

    def close(self) -> None:
        """Stop writing."""
        with self._lock:
            self._recording = None
            self._file.close()
