"""Drawing into a browser: the program ends in order when the viewer or the server goes."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from textual.driver import Driver
from textual.drivers.web_driver import WebDriver


def make_server_safe_driver(driver: type[Driver], on_end: Callable[[], object]) -> type[Driver]:
    """Make a driver that survives its server; any other driver than that of browsers comes back as it is.

    Textual's own ends in a traceback when it writes to a server that has gone, or runs on unseen.

    Args:
        driver: what Textual has chosen.
        on_end: called in the event loop when the viewer or the server has gone; ends the program in order.
    """
    if not issubclass(driver, WebDriver):
        return driver

    class ServerSafeDriver(driver):  # type: ignore[valid-type, misc]  # a subclass of WebDriver, for all we know
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._write = partial(_write_all, self.fileno)

        def on_meta(self, packet_type: str, payload: dict[str, object]) -> None:
            """Take a message of the server; `quit` ends the program as Ctrl-Q does."""
            if packet_type == "quit":
                self._loop.call_soon_threadsafe(on_end)
            else:
                super().on_meta(packet_type, payload)

        def run_input_thread(self) -> None:
            """Read keys until the screen closes, or the server does."""
            super().run_input_thread()
            if not self.exit_event.is_set():
                self._loop.call_soon_threadsafe(on_end)

    return ServerSafeDriver


def _write_all(fileno: int, data: bytes) -> None:
    """Write all of `data`, also if a signal comes in between; nothing once the server has gone."""
    with suppress(OSError):
        while data:
            data = data[os.write(fileno, data) :]
