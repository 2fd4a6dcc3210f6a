"""A proxy in front of a controller, for tests of a client."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from bcapscope.faults.fault_notation import read_fault
from bcapscope.live.child_process import ChildProcess
from bcapscope.testing.recording_context import LOOPBACK, RecordingContext

_IDLE_FOR = 1.0  # seconds without new data; the recorder pauses for at most 0.075 s

_WRITTEN_WITHIN = 5.0  # seconds

_CHECK_INTERVAL = 0.02


class EmbeddedProxy(RecordingContext):
    """A proxy on a free loopback port, over UDP and TCP, in a process of its own.

        with bcapscope.Proxy(to="192.168.0.1:5007", faults=["loss=5%"], seed=3) as proxy:
            run_my_client(proxy.host, proxy.port)

    The proxy works like the proxy of the command `bcapscope proxy`. The proxy records the traffic with the
    client and with the controller. `calls` and `findings` wait until the recorder has been idle for 1 s.

    Attributes:
        host: Address on which the proxy listens.
        port: Port for UDP and TCP; 0 before the `with` block begins.
        recording: Capture of the traffic of both legs. Without `record`, the file is temporary and exists
            until the block ends.
    """

    def __init__(
        self,
        *,
        to: str,
        faults: Sequence[str] = (),
        seed: int | None = None,
        record: str | Path | None = None,
    ) -> None:
        """Choose the controller and the faults; the proxy starts when the `with` block begins.

        Args:
            to: Address of the controller, such as `192.168.0.1:5007`.
            faults: Faults in the notation of `bcapscope proxy --fault`, such as `loss=5%`.
            seed: Random seed of the faults. The same seed and traffic give the same faults.
            record: Path of the capture to write; the file must not exist.

        Raises:
            InputError: A fault is invalid.
        """
        super().__init__(record)
        for fault in faults:
            read_fault(fault)
        self._words = ["--listen", f"{LOOPBACK}:0", "--to", to, "--quiet"]
        self._words += [word for fault in faults for word in ("--fault", fault)]
        self._words += [] if seed is None else ["--seed", str(seed)]
        self._process: ChildProcess | None = None

    def _start(self, opened: ExitStack) -> tuple[int, ...]:
        """Raises ChildStartError if the proxy cannot start, for example because the address is invalid."""
        self._process = ChildProcess("proxy", *self._words, "--record", str(self.recording.resolve()))
        listening, _, controller = self._process.listen_addresses[0].partition(" > ")
        return int(listening.rpartition(":")[2]), int(controller.rpartition(":")[2])

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.terminate()

    def _write_recording(self) -> None:
        until, size, idle_since = time.monotonic() + _WRITTEN_WITHIN, -1, 0.0
        while (now := time.monotonic()) < until:
            if (written := self.recording.stat().st_size) != size:
                size, idle_since = written, now
            if now - idle_since >= _IDLE_FOR:
                return
            time.sleep(_CHECK_INTERVAL)
