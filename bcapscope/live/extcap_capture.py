"""A capture for Wireshark: a command of bcapscope records to a pipe until Wireshark ends the capture."""

from __future__ import annotations

import errno
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import TypeAlias

from bcapscope.errors import BcapError, FileWriteError
from bcapscope.live.child_process import ChildProcess, ChildStartError
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.os_errors import os_reason

CaptureEnds: TypeAlias = "SimpleQueue[Message | None]"
"""Queue of reasons to end a capture: a `Message` for a failure, or None if Wireshark ended the capture."""

_END_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

_READ_WITHIN = 30.0
"""Maximum time in seconds until Wireshark's capture program has opened the pipe."""

_CHECK_INTERVAL = 0.02
_PARENT_INTERVAL_MS = 500

_SYNCHRONIZE, _INFINITE = 0x100000, 0xFFFFFFFF
"""Access right and waiting time of the Windows functions `OpenProcess` and `WaitForSingleObject`."""

_ERROR = "Error: "


class CaptureFailedError(BcapError):
    """A capture ended although Wireshark did not end it; `code` is the exit code."""

    def __init__(self, message: Message, code: int) -> None:
        super().__init__(message)
        self.code = code


@contextmanager
def wireshark_connected(pipe: str) -> Iterator[CaptureEnds]:
    """Connect to Wireshark. The yielded queue receives a reason when the capture must end.

    The pipe stays open until the program ends. After a failed capture, Wireshark therefore sees that the pipe
    closes. If the pipe did not close, tshark 4.0 would wait forever for the first packet. Raises
    FileWriteError if the pipe does not exist, or no program reads it.
    """
    ends: CaptureEnds = SimpleQueue()
    for number in _END_SIGNALS:
        signal.signal(number, lambda *_: ends.put(None))
    descriptor = None if sys.platform == "win32" else _open_pipe(pipe, ends)
    threading.Thread(target=_wait_for_end, args=(descriptor, ends), name="wireshark", daemon=True).start()
    yield ends


def run_capture(words: Sequence[str], pipe: str, ends: CaptureEnds) -> None:
    """Run a command that records to `pipe`, until the queue `ends` receives a reason to end the capture.

    A child process is needed because Wireshark would show the command's messages on standard error as errors.
    The first signal ends the command gracefully; further signals have no effect. Raises CaptureFailedError if
    the command did not start, or ended before Wireshark ended the capture.
    """
    if not ends.empty():
        return
    try:
        child = ChildProcess(*words, "--quiet", "--record", pipe)
    except ChildStartError as error:
        if ends.empty():
            raise CaptureFailedError(_start_failure(error), error.code) from None
        return
    child.subscribe_end(
        lambda line: ends.put(foreign_text(line) if line else Message("extcap.command-killed"))
    )
    reason = ends.get()
    child.terminate()
    if reason is not None:
        raise CaptureFailedError(reason, 1)


def _start_failure(error: ChildStartError) -> Message:
    """Return the error text of the command, without the lines about usage."""
    starts = [number for number, line in enumerate(error.lines) if line.startswith(_ERROR)]
    if not starts:
        return error.message
    return foreign_text("\n".join(error.lines[starts[-1] :]).removeprefix(_ERROR))


def _open_pipe(pipe: str, ends: CaptureEnds) -> int | None:
    """Wait until a program reads the pipe, then open the pipe. Return None if a signal ends the capture."""
    assert sys.platform != "win32"
    until = time.monotonic() + _READ_WITHIN
    while ends.empty():
        try:
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise FileWriteError(Path(pipe), os_reason(error)) from None
            if time.monotonic() > until:
                raise FileWriteError(Path(pipe), Message("recording.no-reader")) from None
        time.sleep(_CHECK_INTERVAL)
    return None


def _wait_for_end(descriptor: int | None, ends: CaptureEnds) -> None:
    """Wait until Wireshark closes the pipe or is killed; on Windows, until Wireshark ends the launcher."""
    if sys.platform == "win32":
        import ctypes

        kernel = ctypes.WinDLL("kernel32")
        kernel.WaitForSingleObject(kernel.OpenProcess(_SYNCHRONIZE, False, os.getppid()), _INFINITE)
    elif descriptor is not None:
        parent, poll = os.getppid(), select.poll()
        poll.register(descriptor, 0)
        # `poll` reports a pipe without a reader, even if no event is registered. If Wireshark is killed,
        # Wireshark's capture program closes the pipe only when the next packet arrives. Before the next
        # packet, only a changed parent process (`getppid`) shows that Wireshark was killed.
        while not poll.poll(_PARENT_INTERVAL_MS) and os.getppid() == parent:
            pass
    ends.put(None)
