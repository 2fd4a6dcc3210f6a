"""Textual's drivers, extended by the HALT keys and by survival of a lost terminal, viewer or server.

This module uses private names of Textual, for which Textual has no public interface: review it when Textual
is upgraded.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import IO, Any

from textual.driver import Driver
from textual.drivers.web_driver import WebDriver
from textual.events import Key
from textual.message import Message

HALT_KEYS = ("f12", "ctrl+backslash")
"""Keys that stop the robot on every screen."""


def make_halt_driver(driver: type[Driver], halt: Callable[[], object]) -> type[Driver]:
    """Return a terminal driver that calls `halt` in its reading thread as soon as it reads a HALT key.

    The driver also discards its output after the terminal has gone, and takes over the terminal again when a
    stopped program continues.
    """

    class HaltDriver(driver):  # type: ignore[valid-type, misc]  # the base class varies
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
            """Take over the terminal again; a terminal that hangs up sends SIGCONT after SIGHUP.

            Textual alone would start second threads for reading and writing, and later end only one of each.
            """
            if not os.isatty(self.fileno):
                return
            if self._auto_restart and not self._must_signal_resume:
                self.suspend_application_mode()
                self._must_signal_resume = True  # redraws everything
            super()._sigcont_application(*arguments)

    return HaltDriver


class _HangupSafeFile:
    """An output file that discards data after the terminal has gone.

    An error would end Textual's writing thread, and the program's shutdown would wait for that thread for
    ever.
    """

    def __init__(self, file: IO[str]) -> None:
        self._file = file
        self.fileno = file.fileno

    def write(self, text: str) -> None:
        with suppress(OSError):
            self._file.write(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._file.flush()


def make_server_safe_driver(driver: type[Driver], on_end: Callable[[], object]) -> type[Driver]:
    """Return a browser driver that survives the loss of its server; return any other driver unchanged.

    Textual's browser driver raises an error when the server has gone, or keeps running unseen.

    Args:
        on_end: Ends the program in order. The event loop calls it when the viewer or the server has gone.
    """
    if not issubclass(driver, WebDriver):
        return driver

    class ServerSafeDriver(driver):  # type: ignore[valid-type, misc]  # mypy cannot know the base class
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._write = partial(_write_all, self.fileno)
            self._end_program = partial(asyncio.get_running_loop().call_soon_threadsafe, on_end)

        def on_meta(self, packet_type: str, payload: dict[str, object]) -> None:
            """Handle a message from the server; the message `quit` ends the program as Ctrl-Q does."""
            if packet_type == "quit":
                self._end_program()
            else:
                super().on_meta(packet_type, payload)

        def run_input_thread(self) -> None:
            """Read keys until the screen closes or the server disconnects."""
            super().run_input_thread()
            if not self.exit_event.is_set():
                self._end_program()

    return ServerSafeDriver


def _write_all(fileno: int, data: bytes) -> int:
    """Write all of `data`, even if a signal interrupts a write; after the server has gone, discard it."""
    size = len(data)
    with suppress(OSError):
        while data:
            data = data[os.write(fileno, data) :]
    return size
