"""A context manager that records b-CAP traffic, and shows its calls and findings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Self

from bcapscope.errors import InputError
from bcapscope.messages import Message

if TYPE_CHECKING:
    from bcapscope.analysis.finding import Finding
    from bcapscope.testing.recorded_traffic import RecordedTraffic
    from bcapscope.traffic.call import Call

LOOPBACK = "127.0.0.1"


class RecordingContext(ABC):
    """Records the traffic of a `with` or `async with` block. If `record` is None, the file is temporary.

    `async with` starts and stops the recording in a thread, so that the event loop does not wait. If the
    asyncio task is cancelled, the recording stops before `async with` raises CancelledError.
    """

    def __init__(self, record: str | Path | None) -> None:
        self.host: str = LOOPBACK
        self.port: int = 0
        self.recording: Path = Path() if record is None else Path(record)
        self._is_temporary = record is None
        self._ports: tuple[int, ...] = ()
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
    def _start(self, opened: ExitStack) -> tuple[int, ...]:
        """Return the ports of controllers in the recording; clients connect to the first. `opened` outlasts
        `_stop`."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop serving clients, and complete the recording."""

    @abstractmethod
    def _write_recording(self) -> None:
        """Write all traffic so far to the file of the recording."""

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            if self._is_temporary:
                folder = opened.enter_context(TemporaryDirectory(prefix="bcapscope-"))
                self.recording = Path(folder, "traffic.pcapng")
            self._ports = self._start(opened)
            self.port = self._ports[0]
            self._last_traffic, self._is_running = None, True
            self._stack = opened.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        with self._stack:
            self._is_running = False
            self._stop()
            self._last_traffic = self._read_recording()

    async def __aenter__(self) -> Self:
        if await _was_cancelled_during(self.__enter__):
            await _was_cancelled_during(self.__exit__)
            raise _cancellation()
        return self

    async def __aexit__(self, *error: object) -> None:
        if await _was_cancelled_during(self.__exit__):
            raise _cancellation()

    def _read_recording(self) -> RecordedTraffic:
        from bcapscope.testing.recorded_traffic import RecordedTraffic  # imports NumPy

        return RecordedTraffic(self.recording, self._ports)


async def _was_cancelled_during(work: Callable[[], object]) -> bool:
    """Run `work` in a thread to its end; return whether the asyncio task was cancelled meanwhile."""
    import asyncio

    task, is_cancelled = asyncio.ensure_future(asyncio.to_thread(work)), False
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:
            is_cancelled = True
    task.result()
    return is_cancelled


def _cancellation() -> BaseException:
    import asyncio

    return asyncio.CancelledError()
