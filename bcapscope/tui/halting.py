"""HALT as the terminal's input has it: seen in the thread that reads the keys, before the event loop.

The screen's event loop may be busy or stuck; the key must do its work all the same.
"""

from __future__ import annotations

from collections.abc import Callable

from textual.driver import Driver
from textual.events import Key
from textual.message import Message

HALT_KEYS = ("f12", "ctrl+backslash")
"""Keys that stop the robot, from every screen."""


def halting(driver: type[Driver], halt: Callable[[], None]) -> type[Driver]:
    """Make a driver that calls `halt` as soon as one of the keys is read.

    Args:
        driver: that of the platform.
        halt: called in the thread that reads the keys; returns at once and must not raise.
    """

    class Halting(driver):  # type: ignore[valid-type, misc]  # which driver it is, the platform decides
        def process_message(self, message: Message) -> None:
            if isinstance(message, Key) and message.key in HALT_KEYS:
                halt()
            super().process_message(message)

    return Halting
