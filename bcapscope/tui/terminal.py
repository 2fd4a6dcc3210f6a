"""Terminal drivers, and a filter that removes control characters from the lines of the screen."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import IO, Any

from rich.cells import cell_len
from rich.segment import Segment
from textual.color import Color
from textual.driver import Driver
from textual.drivers.web_driver import WebDriver
from textual.events import Key
from textual.filter import LineFilter
from textual.message import Message

HALT_KEYS = ("f12", "ctrl+backslash")
"""Keys that stop the robot on every screen."""


def make_halt_driver(driver: type[Driver], halt: Callable[[], object]) -> type[Driver]:
    """Return a terminal driver whose reading thread calls `halt` as soon as it reads a HALT key. The driver
    also discards its output once the terminal is gone. When the program continues after a stop (SIGCONT), the
    driver takes over the terminal again.
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
            """Take over the terminal again after SIGCONT. Do nothing if the terminal no longer exists.

            Textual's own method would start a second reading thread and a second writing thread. If two
            reading threads and two writing threads run, Textual ends only one of each.
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

    If writing raised an error, Textual's writing thread would end, and the program would never finish its
    shutdown.
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
    """Extend a browser driver: the new driver ends the program if the web server is gone. Return any other
    driver unchanged. Without the web server, Textual's own browser driver raises an error or continues to run
    unseen.

    Args:
        on_end: Function that ends the program cleanly. The event loop calls `on_end` when the viewer or the
            server is gone.
    """
    if not issubclass(driver, WebDriver):
        return driver

    class ServerSafeDriver(driver):  # type: ignore[valid-type, misc]  # mypy cannot know the base class
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._write = partial(_write_all, self.fileno)
            self._end_program = partial(asyncio.get_running_loop().call_soon_threadsafe, on_end)

        def on_meta(self, packet_type: str, payload: dict[str, object]) -> None:
            """Handle a message from the server; `quit` ends the program in the same way as Ctrl-Q."""
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
    """Write the whole of `data`, even if a signal interrupts one write operation. Discard `data` if the
    server is gone.
    """
    size = len(data)
    with suppress(OSError):
        while data:
            data = data[os.write(fileno, data) :]
    return size


_REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
_IDEOGRAPHIC_SPACE = "\u3000"
"""Python does not count the ideographic space as printable, but Japanese texts often use this character."""


class ControlCharFilter(LineFilter):
    """Replaces or removes each character that is not printable."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        if all(segment.text.isprintable() for segment in segments):
            return segments
        return [
            segment
            if segment.text.isprintable()
            else Segment(_replace_control_chars(segment.text), segment.style)
            for segment in segments
        ]


def _replace_control_chars(text: str) -> str:
    """Replace each unprintable character with one U+FFFD per terminal column of the character. A control
    character has no column, so the function removes control characters.
    """
    return "".join(
        char if char.isprintable() or char == _IDEOGRAPHIC_SPACE else _REPLACEMENT * cell_len(char)
        for char in text
    )
