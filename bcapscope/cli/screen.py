"""A terminal that is written to by a thread of its own, so that nobody waits for one that has stopped."""

from __future__ import annotations

import shutil
import sys
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress

from bcapscope.cli.output import forget_stdout

MOST_WAITING = 20_000
"""Lines that wait for a terminal, or whatever reads them, before newer ones are dropped and counted."""

_LEAVES_WITHIN = 2.0
"""Seconds that what is left may take at the end."""

_ERASE = "\r\x1b[K"


class Screen:
    """Data for stdout, sentences for stderr, and a line at the bottom of a terminal that is always anew.

    When stdout is closed, that is told in one sentence, and everything else goes on.
    """

    def __init__(self) -> None:
        self._lines: deque[bytes] = deque()
        self._sentences: deque[str] = deque()
        self._status = ""
        self._shown = False
        self._dropped = 0
        self._over = False
        self._heard = True
        self._terminal = sys.stderr.isatty()
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="screen", daemon=True)
        self._thread.start()

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
            self._news.notify()

    def tell(self, text: str) -> None:
        """Write a sentence."""
        with self._news:
            if len(self._sentences) < MOST_WAITING:
                self._sentences.append(text)
            self._news.notify()

    def status(self, text: str) -> None:
        """Write the line at the bottom."""
        with self._news:
            self._status = text
            self._news.notify()

    def close(self) -> None:
        """Write what is left, if the terminal takes it soon."""
        with self._news:
            self._over = True
            self._status = ""
            self._news.notify()
        self._thread.join(_LEAVES_WITHIN)

    def _run(self) -> None:
        over = False
        while not over:
            with self._news:
                self._news.wait_for(self._has_news)
                lines, self._lines = self._lines, deque()
                sentences, self._sentences = self._sentences, deque()
                dropped, self._dropped = self._dropped, 0
                status, over = self._status, self._over
            if dropped:
                sentences.append(f"{dropped} lines are not shown: there was no time to write them")
            self._write(lines, sentences, status)

    def _has_news(self) -> bool:
        return bool(self._lines or self._sentences or self._over or (self._terminal and self._status))

    def _write(self, lines: Sequence[bytes] | deque[bytes], sentences: deque[str], status: str) -> None:
        self._put_error(_ERASE if self._shown else "")
        self._shown = False
        if lines and self._heard:
            try:
                sys.stdout.buffer.write(b"\n".join(lines) + b"\n")
                sys.stdout.buffer.flush()
            except (OSError, ValueError):
                self._heard = False
                forget_stdout()
                sentences.append(
                    "standard output is closed: nothing is shown there any more, the relay goes on"
                )
        self._put_error("".join(f"{sentence}\n" for sentence in sentences))
        if status and self._terminal:
            width = shutil.get_terminal_size().columns - 1
            self._put_error(status[:width])
            self._shown = True
        self._status = ""

    def _put_error(self, text: str) -> None:
        if text:
            with suppress(OSError, ValueError):  # a terminal that is closed hears no sentences
                sys.stderr.write(text)
                sys.stderr.flush()
