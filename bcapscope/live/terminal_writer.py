"""Writes to a terminal from separate threads, so that other threads work on if Ctrl-S stops the terminal."""

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

from bcapscope.live.standard_streams import discard_stdout
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.render.escape import printable

MAX_WAITING = 20_000
"""Maximum number of lines, and also of messages, that may wait to be written. At this limit, `TerminalWriter`
drops newer lines and newer messages. `TerminalWriter` reports how many lines it dropped.
"""

_LINES_WITHIN = 2.0

_MESSAGES_WITHIN = 0.5

_WRITE_SIZE = 4096
"""A pipe accepts a write of up to this size completely, or not at all (PIPE_BUF of Linux)."""

ERASE_LINE = "\r\x1b[K"


class TerminalWriter:
    """Writes lines to stdout, messages to stderr, and a status line at the bottom of a terminal.

    Lines and messages have separate threads, so that messages appear even if stdout blocks. If stdout is
    closed or its disk is full, a message reports this. The writer bypasses Python's buffers. A thread that
    waits for the terminal would hold the buffer's lock and delay the end of the program.
    """

    def __init__(self, words: MessageFormatter = ENGLISH_WORDS) -> None:
        self._words = words
        self._lines: deque[bytes] = deque()
        self._messages: deque[str] = deque()
        self._status = ""
        self._status_is_shown = False
        self._dropped = self._unwritten = 0
        self._no_more_lines = self._is_closing = False
        self._stdout_works = True
        self.shows_status = sys.stderr.isatty()
        self._changed = threading.Condition()
        self._stderr_lock = threading.Lock()
        # If stdout is a pipe that blocks, the status line on the terminal must not wait for stdout.
        self._shares_terminal = self.shows_status and sys.stdout.isatty()
        self._stdout_lock: AbstractContextManager[object] = (
            self._stderr_lock if self._shares_terminal else nullcontext()
        )
        self._line_thread = threading.Thread(target=self._run_lines, name="lines", daemon=True)
        self._message_thread = threading.Thread(target=self._run_messages, name="sentences", daemon=True)
        self._line_thread.start()
        self._message_thread.start()

    def write_lines(self, lines: Sequence[bytes | str]) -> None:
        if not self._stdout_works:
            return
        with self._changed:
            room = MAX_WAITING - len(self._lines)
            self._dropped += max(len(lines) - room, 0)
            self._lines += [
                line if isinstance(line, bytes) else line.encode("utf-8", "replace") for line in lines[:room]
            ]
            self._changed.notify_all()

    def show(self, message: Message) -> None:
        self.write_message(printable(self._words.text(message)))

    def write_message(self, text: str) -> None:
        with self._changed:
            if len(self._messages) < MAX_WAITING:
                self._messages.append(text)
            self._changed.notify_all()

    def set_status(self, text: str) -> None:
        with self._changed:
            self._status = text
            self._changed.notify_all()

    def close(self) -> None:
        """Write the remaining lines, then the remaining messages. Wait for the lines for at most
        `_LINES_WITHIN` seconds, then for the messages for at most `_MESSAGES_WITHIN` seconds.
        """
        with self._changed:
            self._no_more_lines = True
            self._changed.notify_all()
        self._line_thread.join(_LINES_WITHIN)
        left = len(self._lines) + self._unwritten + self._dropped
        if self._line_thread.is_alive() and left:
            self.write_message(self._words("terminal.lines.stuck", lines=f"{left:,}"))
        with self._changed:
            self._is_closing = True
            self._status = ""
            self._changed.notify_all()
        self._message_thread.join(_MESSAGES_WITHIN)

    def _run_lines(self) -> None:
        over = False
        while not over:
            with self._changed:
                self._changed.wait_for(lambda: self._lines or self._dropped or self._no_more_lines)
                lines, self._lines = self._lines, deque()
                self._unwritten = len(lines)
                over = self._no_more_lines
            if lines and self._stdout_works:
                self._put_lines(b"\n".join(lines) + b"\n")
            with self._changed:
                dropped, self._dropped = self._dropped, 0
            if dropped:
                self.write_message(self._words("terminal.lines.no-time", lines=f"{dropped:,}"))

    def _put_lines(self, data: bytes) -> None:
        try:
            with self._stdout_lock:
                if self._shares_terminal:
                    self._erase()
                for written in _write_unbuffered(sys.stdout, data):
                    self._unwritten -= written.count(b"\n")
        except (OSError, ValueError) as error:
            self._stdout_works = False
            self._unwritten = 0
            discard_stdout()
            is_full = isinstance(error, OSError) and error.errno == errno.ENOSPC
            self.write_message(self._words("terminal.stdout.full" if is_full else "terminal.stdout.closed"))

    def _run_messages(self) -> None:
        over = False
        while not over:
            with self._changed:
                self._changed.wait_for(self._has_message)
                sentences, self._messages = self._messages, deque()
                status, self._status = self._status, ""
                over = self._is_closing
            with self._stderr_lock:
                self._erase()
                self._put_error("".join(f"{each}\n" for each in sentences))
                if status and self.shows_status:
                    self._put_error(status[: shutil.get_terminal_size().columns - 1])
                    self._status_is_shown = True

    def _has_message(self) -> bool:
        return bool(self._messages or self._is_closing or (self.shows_status and self._status))

    def _erase(self) -> None:
        if self._status_is_shown:
            self._put_error(ERASE_LINE)
            self._status_is_shown = False

    def _put_error(self, text: str) -> None:
        if text:
            with suppress(OSError, ValueError):  # a closed terminal can show no messages
                for _ in _write_unbuffered(sys.stderr, text.encode("utf-8", "backslashreplace")):
                    pass


def _write_unbuffered(stream: TextIO, data: bytes) -> Iterator[bytes]:
    """Write data without Python's buffer. After each write, yield the bytes that were written."""
    raw = getattr(stream.buffer, "raw", stream.buffer)
    at = 0
    while at < len(data):
        count = raw.write(data[at : at + _WRITE_SIZE])
        if not count:  # If a non-blocking stream accepts nothing now, wait until it accepts data.
            select.select((), (raw,), ())
            continue
        yield data[at : at + count]
        at += count
