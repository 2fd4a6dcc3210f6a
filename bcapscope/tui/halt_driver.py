"""Extends Textual's terminal driver by the HALT keys and by survival of a lost terminal.

The driver's reading thread detects the HALT keys. HALT therefore works even if the event loop is busy or
stuck.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from textual.driver import Driver
from textual.events import Key
from textual.message import Message

from bcapscope.tui.textual_internals import make_resumable_driver, survive_lost_terminal

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
