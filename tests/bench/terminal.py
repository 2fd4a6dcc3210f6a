"""A program in a terminal of its own: keys go in, and when their effect is on the screen is measured."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
LIMIT = 60.0
"""Seconds after which something that should have been drawn was not."""

_KEPT = 1 << 16
"""Bytes of what was drawn that are looked through: a large screen, drawn several times."""

_SYNCHRONISED = b"\x1b[?2026;2$y"
"""Says that the terminal draws all between two marks at once, so that the program sends the marks."""

_STYLES = re.compile(rb"\x1b\[[0-9;?$]*[a-zA-Z]")


class Terminal:
    """Runs a command in a pseudo-terminal; also a context manager that ends it.

    Attributes:
        began: when the command was started, seconds of `time.perf_counter`.
    """

    def __init__(self, argv: Sequence[str], columns: int, rows: int) -> None:
        """Start a command in a terminal of so many columns and rows."""
        self._master, slave = pty.openpty()
        self._set_size(columns, rows)
        environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor", "LANG": "C.UTF-8"}
        self.began = time.perf_counter()
        self._process = subprocess.Popen(
            argv, stdin=slave, stdout=slave, stderr=slave, cwd=ROOT, env=environment, start_new_session=True
        )
        os.close(slave)
        self._text = b""
        os.write(self._master, _SYNCHRONISED)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            end = time.monotonic() + 10
            while self._process.poll() is None and time.monotonic() < end:
                self._take(0.1)
        finally:
            self._process.kill()
            self._process.wait()
            os.close(self._master)

    def press(self, keys: bytes) -> None:
        """Send what a terminal sends for keys."""
        self._text = b""
        os.write(self._master, keys)

    def resize(self, columns: int, rows: int) -> None:
        """Give the terminal another size and tell the program."""
        self._text = b""
        self._set_size(columns, rows)
        self._process.send_signal(signal.SIGWINCH)

    def _set_size(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def until(self, *wanted: str, limit: float = LIMIT) -> float:
        """Read what is drawn until one of some texts was among it, and return when that was.

        Raises:
            SystemExit: it was not drawn in time.
        """
        patterns = [each.encode() for each in wanted]
        end = time.perf_counter() + limit
        while True:
            if any(pattern in self.seen() for pattern in patterns):
                return time.perf_counter()
            if time.perf_counter() > end or not self._take(end - time.perf_counter()):
                sys.exit(f"not drawn within {limit} s: {wanted}; last: {self._text[-2000:]!r}")

    def rest(self, seconds: float) -> None:
        """Read what is drawn for a while."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._take(left)
        self._text = self._text[-_KEPT:]

    def wait(self, limit: float) -> None:
        """Read what is drawn until the program ends.

        Raises:
            SystemExit: it does not in time.
        """
        end = time.perf_counter() + limit
        while self._process.poll() is None:
            if time.perf_counter() > end:
                sys.exit(f"it has not ended within {limit} s; last: {self.seen()[-2000:]!r}")
            self._take(0.1)
            self._text = self._text[-_KEPT:]

    def seen(self) -> bytes:
        """Return what was drawn lately, without styles."""
        return _STYLES.sub(b"", self._text)

    def _take(self, seconds: float) -> bool:
        ready, _, _ = select.select([self._master], [], [], max(0, seconds))
        if ready:
            try:
                data = os.read(self._master, 1 << 16)
            except OSError:
                return False
            self._text += data
        return True

    def megabytes(self) -> dict[str, float]:
        """Return the memory of the program and its children in MB (10^6 bytes), by their module.

        What processes share is divided among them (proportional set size).
        """
        found: dict[str, float] = {}
        for each in (self._process.pid, *_children(self._process.pid)):
            try:
                words = Path(f"/proc/{each}/cmdline").read_bytes().decode().split("\0")
                text = Path(f"/proc/{each}/smaps_rollup").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue  # it has ended
            name = words[words.index("-m") + 1] if "-m" in words else words[0]
            kilobytes = int(text.split("\nPss:")[1].split()[0])
            found[name] = found.get(name, 0) + kilobytes * 1024 / 1e6
        return found


def _children(pid: int) -> list[int]:
    """List the descendants of a process."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    direct = [child for thread in threads for child in (thread / "children").read_text().split()]
    return [each for child in map(int, direct) for each in (child, *_children(child))]
