"""Reads single key presses from the terminal while a command runs."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from typing import Any

from bcapscope.live.standard_streams import can_poll_stdin

_ESCAPE = "\x1b"
_SEQUENCE = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O[A-Za-z])")  # matches arrow keys, function keys and similar


class TerminalKeys:
    """Between `start` and `stop`, the terminal delivers each key at once and without echo. Ctrl-C works."""

    def __init__(self) -> None:
        self.is_on = False
        self._is_available = can_poll_stdin() and os.isatty(0)
        self._saved_attributes: list[Any] = []
        self._escape_count = 0

    def start(self) -> None:
        if self._is_available and not self.is_on:
            import termios
            import tty

            self._saved_attributes = termios.tcgetattr(0)
            tty.setcbreak(0)
            self.is_on = True

    def stop(self) -> None:
        if self.is_on:
            import termios

            self.is_on = False
            with suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(0, termios.TCSADRAIN, self._saved_attributes)

    def read_keys(self) -> str:
        """Return the typed characters in lower case. Call this method when file descriptor 0 is readable.

        At a first press of Escape, return nothing. If the next key is Escape again, after any pause, return
        two Escapes. Escape sequences, such as those of arrow keys, are removed.
        """
        data = os.read(0, 64)
        if not data:
            self.stop()
            self._is_available = False
        text = _SEQUENCE.sub("", data.decode(errors="replace")).lower()
        others = text.replace(_ESCAPE, "")
        self._escape_count = 0 if others else self._escape_count + len(text)
        return _ESCAPE * 2 if self._escape_count > 1 else others
