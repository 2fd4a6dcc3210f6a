"""Textual's drivers, extended by the HALT keys and by survival of a lost terminal, viewer or server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from textual.driver import Driver
from textual.drivers.web_driver import WebDriver
from textual.events import Key
from textual.message import Message

from bcapscope.tui.textual_internals import make_resumable_driver, survive_lost_server, survive_lost_terminal

HALT_KEYS = ("f12", "ctrl+backslash")
"""Keys that stop the robot on every screen."""


def make_halt_driver(driver: type[Driver], halt: Callable[[], object]) -> type[Driver]:
    """Return a driver that calls `halt` in its reading thread as soon as it reads a HALT key."""

    class HaltDriver(make_resumable_driver(driver)):  # type: ignore[misc]  # the base class varies
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            survive_lost_terminal(self)

        def process_message(self, message: Message) -> None:
            if isinstance(message, Key) and message.key in HALT_KEYS:
                halt()
            super().process_message(message)

    return HaltDriver


def make_server_safe_driver(driver: type[Driver], on_end: Callable[[], object]) -> type[Driver]:
    """Return a browser driver that survives the loss of its server; return any other driver unchanged.

    Without this change, Textual's browser driver raises an error when the server has gone, or keeps running
    unseen.

    Args:
        on_end: Function that ends the program in order. The driver calls the function in the event loop when
            the viewer or the server has gone.
    """
    if not issubclass(driver, WebDriver):
        return driver

    class ServerSafeDriver(driver):  # type: ignore[valid-type, misc]  # mypy cannot know the base class
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            survive_lost_server(self)
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
