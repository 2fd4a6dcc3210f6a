"""What Textual's way to the terminal has to do besides: HALT, and outlasting the terminal.

HALT is seen in the thread that reads the keys, before the event loop, which may be busy or stuck, and does
its work all the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

from textual.driver import Driver
from textual.events import Key
from textual.message import Message

HALT_KEYS = ("f12", "ctrl+backslash")
"""Keys that stop the robot, from every screen."""


def make_halt_driver(driver: type[Driver], halt: Callable[[], object]) -> type[Driver]:
    """Make a driver that calls `halt` as soon as one of the keys is read.

    Args:
        driver: that of the platform.
        halt: called in the thread that reads the keys; returns at once and must not raise.
    """

    class HaltDriver(driver):  # type: ignore[valid-type, misc]  # which driver it is, the platform decides
        _must_signal_resume: bool

        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            file: IO[str] | None = getattr(self, "_file", None)
            if file is not None:
                self._file = _HangupSafeFile(file)

        def process_message(self, message: Message) -> None:
            if isinstance(message, Key) and message.key in HALT_KEYS:
                halt()
            super().process_message(message)

        def _sigcont_application(self, *arguments: Any) -> None:
            """Take the terminal again after a stop, if it is still there.

            A terminal that hangs up sends SIGCONT behind SIGHUP, and a program may be stopped without being
            asked; Textual would read and write with two threads each, of which it then ends one.
            """
            if not os.isatty(self.fileno):
                return
            if self._auto_restart and not self._must_signal_resume:
                self.suspend_application_mode()
                self._must_signal_resume = True  # has all drawn anew
            super()._sigcont_application(*arguments)

    return HaltDriver


class _HangupSafeFile:
    """A terminal to write to that takes what is written when it is gone.

    Else the thread that writes ends with an error, and whoever waits for it, the end of the program among
    them, waits for ever.
    """

    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def write(self, text: str) -> None:
        with suppress(OSError):
            self._file.write(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._file.flush()

    def fileno(self) -> int:
        return self._file.fileno()
