"""A command of ours that the screen starts: the simulator, or a proxy whose relay must not wait for a screen.

It is told to end by a signal; if the screen is killed, it notices that its standard input has ended.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import orjson

from bcapscope.errors import BcapError

READY_WITHIN = 60.0
"""Seconds that a command has until it listens; a machine that is busy takes long to load a program."""

ENDS_WITHIN = 8.0
"""Seconds that it has to end in order, and then again to end at once."""

_LINES = 500


class ChildError(BcapError):
    """The command did not begin; the text is what it said last.

    Attributes:
        code: its exit code.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class Child:
    """A command that runs.

    Attributes:
        listening: what it listens on, as it told.
        control: where it can be told what to do; "" for nowhere.
    """

    def __init__(self, *words: str) -> None:
        """Start ``bcapscope WORDS --attended`` and wait until it listens.

        Raises:
            ChildError: it does not.
        """
        self._said: deque[str] = deque(maxlen=_LINES)
        self._greeted = threading.Event()
        self._count = 0
        self._lock = threading.Lock()
        self._tell: Callable[[str], None] | None = None
        self._over: Callable[[str], None] = lambda words: None
        self._wanted, self._ended = True, False
        argv = [sys.executable, "-m", "bcapscope", *words, "--attended"]
        self._process = subprocess.Popen(
            argv,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C and a closed terminal are the screen's business
        )
        self._reader = threading.Thread(target=self._read, daemon=True, name="child")
        self._reader.start()
        told = self._begin()
        self.listening, self.control = tuple(told["listening"]), str(told["control"])

    def _begin(self) -> dict[str, Any]:
        """Wait for the line that tells what it listens on."""
        assert self._process.stdout is not None
        patience = threading.Timer(READY_WITHIN, self._process.kill)
        patience.start()
        line = self._process.stdout.readline()
        patience.cancel()
        if line:
            self._greeted.wait(ENDS_WITHIN)
            told: dict[str, Any] = orjson.loads(line)
            return told
        self.end()
        raise ChildError(self.last_words or "it did not begin in time", max(self._process.returncode, 1))

    def _read(self) -> None:
        """Take what it says, line by line, and notice its end."""
        assert self._process.stderr is not None
        for line in self._process.stderr:
            text = line.decode(errors="replace").rstrip()
            if not text and not self._greeted.is_set():
                self._greeted.set()
                continue
            with self._lock:
                self._said.append(text)
                self._count += 1
                tell = self._tell
            if tell is not None:
                tell(text)
        self._process.wait()
        with self._lock:
            self._ended, over = True, self._over
        if self._wanted:
            over(self._reason())

    def _reason(self) -> str:
        """Return why it ended by itself, as far as it could say; "" where it was killed."""
        return "" if self._process.returncode < 0 else self.last_words

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def last_words(self) -> str:
        """The last line that it said, "" if none."""
        with self._lock:
            return next((text for text in reversed(self._said) if text), "")

    def listen(self, tell: Callable[[str], None]) -> None:
        """Have each line that it says told, those said already now; in another thread."""
        with self._lock:
            self._tell = tell
            said = list(self._said)
        for text in said:
            tell(text)

    def at_end(self, over: Callable[[str], None]) -> None:
        """Have told why it ended by itself, "" if killed; in another thread, or now if it has ended."""
        with self._lock:
            self._over, ended = over, self._ended
        if ended and self._wanted:
            over(self._reason())

    def end(self) -> list[str]:
        """End it in order; return what it said meanwhile."""
        self._wanted = False
        before = self._count
        self._tell = None
        for number in (signal.SIGINT, signal.SIGINT, None):
            with suppress(OSError):
                self._process.kill() if number is None else self._process.send_signal(number)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDS_WITHIN)
                break
        self._reader.join(ENDS_WITHIN)
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return list(self._said)[before - self._count :] if before < self._count else []
