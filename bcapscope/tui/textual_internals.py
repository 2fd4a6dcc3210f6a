"""Every use of a private name of Textual; review this module when Textual is upgraded.

Textual has no public interface for these purposes. `tui.web.screen_process` uses the private names of
textual-serve.
"""

from __future__ import annotations

import os
from contextlib import suppress
from functools import partial
from typing import IO, Any

from textual.driver import Driver
from textual.drivers.web_driver import WebDriver
from textual.geometry import Size
from textual.widget import Widget


class UnscrolledWidget(Widget):
    """A widget that never scrolls, so that a new size needs no second layout pass."""

    def _size_updated(
        self, size: Size, virtual_size: Size, container_size: Size, layout: bool = True
    ) -> bool:
        return super()._size_updated(size, virtual_size, container_size, layout=False)


def survive_lost_server(driver: WebDriver) -> None:
    """Make a browser driver discard its output after the server has gone, instead of raising an error."""
    driver._write = partial(_write_all, driver.fileno)


def _write_all(fileno: int, data: bytes) -> int:
    """Write all of `data`, even if a signal interrupts a write; after the server has gone, discard it."""
    size = len(data)
    with suppress(OSError):
        while data:
            data = data[os.write(fileno, data) :]
    return size


def survive_lost_terminal(driver: Driver) -> None:
    """Make a terminal driver discard its output after the terminal has gone, instead of raising an error."""
    file: IO[str] | None = getattr(driver, "_file", None)
    if file is not None:
        driver._file = _HangupSafeFile(file)  # type: ignore[attr-defined]  # terminal drivers have it


class _HangupSafeFile:
    """An output file that discards data after the terminal has gone.

    If writing raised an error, Textual's writing thread would fail, and the program's shutdown would wait for
    that thread for ever.
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


def make_resumable_driver(driver: type[Driver]) -> type[Driver]:
    """Return a driver that takes over the terminal again when a stopped program continues.

    Another process can stop and continue the program; a terminal that hangs up sends SIGCONT after SIGHUP.
    Textual alone would then start second threads for reading and writing, and later end only one of each
    pair.
    """

    class ResumableDriver(driver):  # type: ignore[valid-type, misc]  # base known at run time
        _must_signal_resume: bool

        def _sigcont_application(self, *arguments: Any) -> None:
            if not os.isatty(self.fileno):
                return
            if self._auto_restart and not self._must_signal_resume:
                self.suspend_application_mode()
                self._must_signal_resume = True  # redraws everything
            super()._sigcont_application(*arguments)

    return ResumableDriver
