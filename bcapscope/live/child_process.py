"""Runs a bcapscope command in a child process, which ends if its standard input closes."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, BinaryIO, cast

import orjson

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text

START_TIMEOUT = 60.0
"""Maximum time in seconds until the command listens. A busy machine may load the command slowly."""

END_TIMEOUT = 8.0
"""Maximum time in seconds that the command may take to end after each signal."""

_MAX_LINES = 500


class ChildStartError(BcapError):
    """The command did not start. `lines` are the last lines that the command printed on standard error."""

    def __init__(self, message: Message, code: int, lines: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.code = code
        self.lines = tuple(lines)


class ChildProcess:
    """A running bcapscope command, with the addresses from its report. `control_address` may be ""."""

    def __init__(self, *words: str) -> None:
        """Start ``bcapscope WORDS --attended`` and wait until it listens. Raises ChildStartError."""
        self._output: deque[str] = deque(maxlen=_MAX_LINES)
        self._startup_done = threading.Event()
        self._line_count = 0
        self._lock = threading.Lock()
        self._on_output: Callable[[str], None] | None = None
        self._on_end: Callable[[str], None] = lambda words: None
        self._is_wanted, self._has_ended = True, False
        argv = [sys.executable, "-m", "bcapscope", *words, "--attended"]
        self._process = subprocess.Popen(
            argv,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Ctrl-C and a closed terminal must reach only this process, not the child.
            start_new_session=True,
        )
        self._stdout: BinaryIO | None = cast(BinaryIO, self._process.stdout)
        self._reader = threading.Thread(target=self._read_output, daemon=True, name="child")
        self._reader.start()
        report = self._wait_until_listening()
        self.listen_addresses, self.control_address = tuple(report["listening"]), str(report["control"])

    def _wait_until_listening(self) -> dict[str, Any]:
        patience = threading.Timer(START_TIMEOUT, self._process.kill)
        patience.start()
        assert self._stdout is not None
        line = self._stdout.readline()
        patience.cancel()
        if line:
            self._startup_done.wait(END_TIMEOUT)
            report: dict[str, Any] = orjson.loads(line)
            return report
        self.terminate()
        reason = foreign_text(self.last_line) if self.last_line else Message("process.slow-start")
        raise ChildStartError(reason, max(self._process.returncode, 1), self._output)

    def _read_output(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            text = line.decode(errors="replace").rstrip()
            if not text and not self._startup_done.is_set():
                self._startup_done.set()
                continue
            with self._lock:
                self._output.append(text)
                self._line_count += 1
                on_output = self._on_output
            if on_output is not None:
                on_output(text)
        self._process.wait()
        with self._lock:
            self._has_ended, on_end = True, self._on_end
        if self._is_wanted:
            on_end(self._end_reason())

    def _end_reason(self) -> str:
        return "" if self._process.returncode < 0 else self.last_line

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def last_line(self) -> str:
        with self._lock:
            return next((text for text in reversed(self._output) if text), "")

    def hand_over_stdout(self) -> BinaryIO:
        """Return the pipe of the command's standard output, without the first line, which has already been
        read. The caller closes the pipe.
        """
        assert self._stdout is not None
        stdout, self._stdout = self._stdout, None
        return stdout

    def subscribe_output(self, on_output: Callable[[str], None]) -> None:
        """Call `on_output` with the lines that the command has already printed on standard error. When the
        command prints another line there, another thread calls `on_output`.
        """
        with self._lock:
            self._on_output = on_output
            lines = list(self._output)
        for text in lines:
            on_output(text)

    def subscribe_end(self, on_end: Callable[[str], None]) -> None:
        """If the command ends unexpectedly, call `on_end` with the last line that the command printed on
        standard error. If a signal killed the command, call `on_end` with "". If the command has already
        ended, call `on_end` at once. Otherwise, another thread calls `on_end` later.
        """
        with self._lock:
            self._on_end, ended = on_end, self._has_ended
        if ended and self._is_wanted:
            on_end(self._end_reason())

    def terminate(self) -> list[str]:
        """End the command gracefully. Return the lines that the command printed while it ended."""
        self._is_wanted = False
        before = self._line_count
        self._on_output = None
        # On Windows, Python cannot send SIGINT to another process.
        graceful = () if sys.platform == "win32" else (signal.SIGINT, signal.SIGINT)
        for number in (*graceful, None):
            with suppress(OSError):
                self._process.kill() if number is None else self._process.send_signal(number)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT)
                break
        self._reader.join(END_TIMEOUT)
        for pipe in (self._process.stdin, self._stdout, self._process.stderr):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return list(self._output)[before - self._line_count :] if before < self._line_count else []
