"""Where traffic comes from: capture files one after the other, or standard input."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import BinaryIO, cast

from bcapscope.capture.file import CaptureFile, open_capture
from bcapscope.capture.packet import Packet
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate
from bcapscope.cli.progress import Progress
from bcapscope.errors import CaptureError
from bcapscope.render.escape import printable

STDIN = "-"


class Files:
    """Captures read one after the other as one traffic, as the files of a ring are.

    Attributes:
        exit: how reading went so far.
    """

    def __init__(self, paths: Sequence[str], flush: Callable[[], None]) -> None:
        """Read `paths`, ``-`` being standard input; call `flush` before waiting for a pipe."""
        self.exit = Exit.OK
        self._paths = paths
        self._flush = flush
        self._progress = Progress()
        self._file: CaptureFile | None = None

    def pause(self) -> None:
        """Show how far reading has come, if it takes long."""
        if self._file is not None:
            self._progress.show(self._file.position, self._file.size)

    def packets(self) -> Iterator[Packet]:
        """Yield the packets of all captures; what cannot be read is told in one sentence each."""
        for path in self._paths:
            try:
                with self._open(path) as self._file:
                    yield from self._file
            except CaptureError as error:
                self._report(path, error)
        self._progress.done()

    def _open(self, path: str) -> CaptureFile:
        if path != STDIN:
            return open_capture(path)
        return CaptureFile(cast(BinaryIO, _Patient(sys.stdin.buffer, self._flush)))

    def _report(self, path: str, error: CaptureError) -> None:
        self._flush()
        self._progress.done()
        name = "standard input" if path == STDIN else printable(path)
        narrate(f"{name}: {error}")
        read_something = self._file is not None and bool(error.offset)
        self.exit = max(self.exit, Exit.DAMAGED) if read_something else Exit.UNREADABLE


class _Patient:
    """Standard input that lets everything found so far be written out before it waits for more."""

    def __init__(self, stream: BinaryIO, flush: Callable[[], None]) -> None:
        self._stream = stream
        self._flush = flush

    def read1(self, size: int) -> bytes:
        self._flush()
        return cast(bytes, self._stream.read1(size))  # type: ignore[attr-defined]  # a BufferedReader has it

    def fileno(self) -> int:
        return self._stream.fileno()

    def close(self) -> None:
        """Leave standard input to the interpreter."""
