"""Terminal drivers, and a filter that removes control characters from the lines of the screen."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from io import FileIO
from typing import IO, Any

from rich.cells import cell_len
from rich.segment import Segment
from textual.color import Color
from textual.driver import Driver
from textual.drivers.web_driver import WebDriver
from textual.events import Key
from textual.filter import LineFilter
from textual.message import Message

from bcapscope.capture.append_log import write_all

HALT_KEYS = ("f12", "ctrl+backslash")
"""Keys that stop the robot on every screen."""


def make_halt_driver(driver: type[Driver], halt: Callable[[], object]) -> type[Driver]:
    """Return a terminal driver whose reading thread calls `halt` as soon as it reads a HALT key. The driver
    discards output after the terminal has closed. After SIGCONT, the driver takes over the terminal again.
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
            """Take over the terminal again, unless it no longer exists. Without `suspend_application_mode`,
            Textual would start another reading and another writing thread, and never end the first two.
            """
            if not os.isatty(self.fileno):
                return
            if self._auto_restart and not self._must_signal_resume:
                self.suspend_application_mode()
                self._must_signal_resume = True  # redraws everything
            super()._sigcont_application(*arguments)

    return HaltDriver


class _HangupSafeFile:
    """Discards data after the terminal has closed. An error would end Textual's writing thread."""

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
    """Extend a browser driver, so that the event loop calls `on_end` when the viewer or the web server is
    gone. Textual's own browser driver raises OSError when it writes to a web server that is gone. As long as
    it writes nothing, it does not notice, and the screen runs on unseen. Return any other driver unchanged.
    """
    if not issubclass(driver, WebDriver):
        return driver

    class ServerSafeDriver(driver):  # type: ignore[valid-type, misc]  # mypy cannot know the base class
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._output = FileIO(self.fileno, "w", closefd=False)
            self._write = self._write_while_connected
            self._end_program = partial(asyncio.get_running_loop().call_soon_threadsafe, on_end)

        def _write_while_connected(self, data: bytes) -> None:
            with suppress(OSError):
                write_all(self._output, data)

        def on_meta(self, packet_type: str, payload: dict[str, object]) -> None:
            if packet_type == "quit":
                self._end_program()
            else:
                super().on_meta(packet_type, payload)

        def run_input_thread(self) -> None:
            super().run_input_thread()
            if not self.exit_event.is_set():
                self._end_program()

    return ServerSafeDriver


_REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
_IDEOGRAPHIC_SPACE = "\u3000"  # a space that is frequent in Japanese texts; `isprintable` returns False


class ControlCharFilter(LineFilter):
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
    """Replace each unprintable character with one U+FFFD per column, or remove it if it fills no column."""
    return "".join(
        char if char.isprintable() or char == _IDEOGRAPHIC_SPACE else _REPLACEMENT * cell_len(char)
        for char in text
    )
