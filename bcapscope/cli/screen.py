"""A terminal that is written to by threads of its own, so that nobody waits for one that has stopped."""

from __future__ import annotations

import errno
import select
import shutil
import sys
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TextIO

from bcapscope.cli.output import forget_stdout

MOST_WAITING = 20_000
"""Lines that wait for a terminal, or whatever reads them, before newer ones are dropped and counted."""

_LEAVES_WITHIN = 2.0
"""Seconds that the lines that are left may take at the end."""

_LAST_WORDS_WITHIN = 0.5
"""Seconds that the sentences behind them may take."""

_AT_ONCE = 4096
"""Bytes: a pipe takes so many as a whole or not at all (PIPE_BUF of Linux)."""

ERASE = "\r\x1b[K"
"""Takes the line at the bottom away."""


class Screen:
    """Data for stdout, sentences for stderr, and a line at the bottom of a terminal that is always anew.

    Each has its thread: what cannot be shown as data is told in a sentence. When stdout is closed, or a file
    on a full disk, that is told, and everything else goes on. Both are written without a buffer: its lock,
    held by a thread that waits for a terminal, would hold up the end of the program.
    """

    def __init__(self) -> None:
        self._lines: deque[bytes] = deque()
        self._sentences: deque[str] = deque()
        self._status = ""
        self._shown = False
        self._dropped = self._unwritten = 0
        self._no_more_lines = self._over = False
        self._heard = True
        self._terminal = sys.stderr.isatty()
        self._news = threading.Condition()
        self._bottom = threading.Lock()
        # Where lines go elsewhere, nobody who writes at the bottom of the terminal must wait for them.
        self._shared = self._terminal and sys.stdout.isatty()
        self._turn: AbstractContextManager[object] = self._bottom if self._shared else nullcontext()
        self._showing = threading.Thread(target=self._show, name="lines", daemon=True)
        self._telling = threading.Thread(target=self._tell, name="sentences", daemon=True)
        self._showing.start()
        self._telling.start()

    @property
    def has_status(self) -> bool:
        """Whether anybody sees the line at the bottom."""
        return self._terminal

    def show(self, lines: Sequence[bytes | str]) -> None:
        """Write lines of data, when the terminal can take them."""
        if not self._heard:
            return
        with self._news:
            room = MOST_WAITING - len(self._lines)
            self._dropped += max(len(lines) - room, 0)
            self._lines += [
                line if isinstance(line, bytes) else line.encode("utf-8", "replace") for line in lines[:room]
            ]
            self._news.notify_all()

    def tell(self, text: str) -> None:
        """Write a sentence."""
        with self._news:
            if len(self._sentences) < MOST_WAITING:
                self._sentences.append(text)
            self._news.notify_all()

    def status(self, text: str) -> None:
        """Write the line at the bottom."""
        with self._news:
            self._status = text
            self._news.notify_all()

    def close(self) -> None:
        """Write what is left, if the terminal takes it soon: lines, then sentences."""
        with self._news:
            self._no_more_lines = True
            self._news.notify_all()
        self._showing.join(_LEAVES_WITHIN)
        left = len(self._lines) + self._unwritten + self._dropped
        if self._showing.is_alive() and left:
            self.tell(f"{left:,} lines are not shown: standard output takes nothing")
        with self._news:
            self._over = True
            self._status = ""
            self._news.notify_all()
        self._telling.join(_LAST_WORDS_WITHIN)

    # lines

    def _show(self) -> None:
        over = False
        while not over:
            with self._news:
                self._news.wait_for(lambda: self._lines or self._dropped or self._no_more_lines)
                lines, self._lines = self._lines, deque()
                self._unwritten = len(lines)
                over = self._no_more_lines
            if lines and self._heard:
                self._put_lines(b"\n".join(lines) + b"\n")
            with self._news:
                dropped, self._dropped = self._dropped, 0
            if dropped:
                self.tell(f"{dropped:,} lines are not shown: there was no time to write them")

    def _put_lines(self, data: bytes) -> None:
        try:
            with self._turn:
                if self._shared:
                    self._erase()
                for written in _written(sys.stdout, data):
                    self._unwritten -= written.count(b"\n")
        except (OSError, ValueError) as error:
            self._heard = False
            self._unwritten = 0
            forget_stdout()
            is_full = isinstance(error, OSError) and error.errno == errno.ENOSPC
            why = "has no room" if is_full else "is closed"
            self.tell(f"standard output {why}: nothing is shown there any more, all else goes on")

    # sentences, and the line at the bottom

    def _tell(self) -> None:
        over = False
        while not over:
            with self._news:
                self._news.wait_for(self._has_news)
                sentences, self._sentences = self._sentences, deque()
                status, self._status = self._status, ""
                over = self._over
            with self._bottom:
                self._erase()
                self._put_error("".join(f"{each}\n" for each in sentences))
                if status and self._terminal:
                    self._put_error(status[: shutil.get_terminal_size().columns - 1])
                    self._shown = True

    def _has_news(self) -> bool:
        return bool(self._sentences or self._over or (self._terminal and self._status))

    def _erase(self) -> None:
        if self._shown:
            self._put_error(ERASE)
            self._shown = False

    def _put_error(self, text: str) -> None:
        if text:
            with suppress(OSError, ValueError):  # a terminal that is closed hears no sentences
                for _ in _written(sys.stderr, text.encode("utf-8", "backslashreplace")):
                    pass


def _written(stream: TextIO, data: bytes) -> Iterator[bytes]:
    """Write, past the buffer; yield each part that is out."""
    raw = getattr(stream.buffer, "raw", stream.buffer)
    at = 0
    while at < len(data):
        count = raw.write(data[at : at + _AT_ONCE])
        if not count:  # whoever gave us the stream made it one that does not wait
            select.select((), (raw,), ())
            continue
        yield data[at : at + count]
        at += count
