"""Extends Textual's terminal driver: HALT keys, and survival of a lost terminal.

The thread that reads the keys detects HALT. HALT therefore works even if the event loop is busy or stuck.
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
"""Keys that stop the robot on every screen."""


def make_halt_driver(driver: type[Driver], halt: Callable[[], object]) -> type[Driver]:
    """Return a driver that calls `halt` as soon as it reads a HALT key.

    Args:
        driver: The platform's driver.
        halt: Called in the thread that reads the keys; returns at once and must not raise.
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
            """Take the terminal over again after a stop, if it still exists.

            A terminal that hangs up sends SIGCONT after SIGHUP, and another process can stop the program.
            Textual would then use two threads each for reading and writing, and end only one of them.
            """
            if not os.isatty(self.fileno):
                return
            if self._auto_restart and not self._must_signal_resume:
                self.suspend_application_mode()
                self._must_signal_resume = True  # redraws everything
            super()._sigcont_application(*arguments)

    return HaltDriver


class _HangupSafeFile:
    """An output file that discards data once the terminal is gone.

    Otherwise the writing thread would fail, and the program could not end: its shutdown waits for that
    thread.
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
