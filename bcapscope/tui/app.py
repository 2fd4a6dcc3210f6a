"""The Textual application, with its screens, themes, settings, HALT and orderly shutdown."""

from __future__ import annotations

import asyncio
import gc
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

from rich.style import Style
from textual.binding import Binding, BindingType
from textual.dom import DOMNode
from textual.driver import Driver
from textual.filter import LineFilter
from textual.notifications import SeverityLevel
from textual.reactive import reactive

from bcapscope.live.standard_streams import discard_unwritable_output
from bcapscope.messages.os_errors import os_reason
from bcapscope.tui.ink import Styles
from bcapscope.tui.key_order import KeyOrderApp
from bcapscope.tui.reader_language import label
from bcapscope.tui.settings import default_settings_path, read_settings, with_recent, write_settings
from bcapscope.tui.terminal import HALT_KEYS, ControlCharFilter, make_halt_driver, make_server_safe_driver
from bcapscope.tui.themes import THEME_NAMES, THEMES, theme_styles

if TYPE_CHECKING:
    from bcapscope.tui.screens.base_screen import BaseScreen

CLOSE_TIMEOUT = 10.0
"""Time limit in seconds for all `closers` together. After this time, the screen closes, even if a closer
still runs.
"""

HALT_KEY_WINDOW = 0.5
"""Time in seconds in which `action_halt` does not halt again after `_halt_by_key`. For each press of a HALT
key, the terminal driver calls `_halt_by_key` first, and Textual calls `action_halt` later.
"""

TERMINAL_CHECK_INTERVAL = 1.0
"""Seconds between two checks that the terminal still exists."""

_GC_THRESHOLDS = (2_000, 20, 1000)
"""A garbage collection delays keys by 1 ms (new objects), 30 ms (also older objects) or 50 ms (all)."""


class ScreenEntry(NamedTuple):
    """A screen that the user can open; `name` is the message id of the screen's label."""

    mode: str
    key: str
    name: str
    create: Callable[[], BaseScreen]


class BcapApp(KeyOrderApp):
    CSS_PATH = ["bcapscope.tcss", "tester.tcss"]  # noqa: RUF012 - Textual declares a list
    TITLE = "bcapscope"
    ENABLE_COMMAND_PALETTE = False  # bcapscope has its own palette, which `BaseScreen` opens
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+q", "quit", "shell.quit", priority=True),
        Binding(HALT_KEYS[0], "halt", "shell.halt", priority=True),
        *(Binding(key, "halt", "", show=False, priority=True) for key in HALT_KEYS[1:]),
        Binding("ctrl+t", "next_theme", "shell.next_theme", show=False, tooltip="shell.theme.tip"),
    ]
    status: reactive[tuple[tuple[str, str], ...]] = reactive((), init=False)
    """Texts at the right of the top bar, each with the name of its style; "" for the plain style."""

    def __init__(self, screen_entries: Sequence[ScreenEntry], settings_path: Path | None = None) -> None:
        # Without this assignment, Textual first shows a blank default screen, and reads all styles for it.
        self.DEFAULT_MODE = screen_entries[0].mode  # type: ignore[misc]  # a class attribute in Textual
        # `_halts` must exist before the terminal driver, because the driver calls the callbacks in `_halts`
        self._halts: list[Callable[[], bool]] = []
        self._last_halt = -math.inf, False
        self._control_char_filter = ControlCharFilter()
        super().__init__()
        self.screen_entries = tuple(screen_entries)
        self._settings_path = settings_path or default_settings_path()
        self.settings, self._settings_problem = read_settings(self._settings_path)
        self.closers = AsyncExitStack()  # callbacks that run before the screen closes
        self._is_ending = False
        self._gc_thresholds = gc.get_threshold()
        for theme in THEMES:
            self.register_theme(theme)
        self.text_styles: Styles = {}
        self._select_theme(self.settings.theme)
        for entry in self.screen_entries:
            self.add_mode(entry.mode, entry.create)
            self.bind(entry.key, f"switch_mode('{entry.mode}')", description=entry.name, show=False)

    def _select_theme(self, name: str) -> None:
        self.theme = name if name in THEME_NAMES else THEME_NAMES[0]

    def watch_theme(self) -> None:
        inks = theme_styles(self.current_theme)
        if self.no_color:
            inks = {name: Style(bold=style.bold) for name, style in inks.items()} | {
                "lit": Style(reverse=True)
            }
        self.text_styles = inks

    def on_load(self) -> None:
        # Avoid Textual's eager tasks (Python 3.12 and later), in which an `Input` raises ScreenStackError.
        asyncio.get_running_loop().set_task_factory(None)

    def on_mount(self) -> None:
        self._install_signal_handlers()
        self.app_resume_signal.subscribe(self, lambda _: self.refresh(layout=True))
        gc.set_threshold(*_GC_THRESHOLDS)
        if self._settings_problem is not None:
            text = label(
                "shell.settings.broken", path=str(self._settings_path), reason=self._settings_problem
            )
            self.show_message(text, "warning")

    def on_unmount(self) -> None:
        gc.unfreeze()
        gc.set_threshold(*self._gc_thresholds)

    def _install_signal_handlers(self) -> None:
        if sys.platform == "win32":
            return
        loop = asyncio.get_running_loop()
        for number in (signal.SIGHUP, signal.SIGTERM):
            loop.add_signal_handler(number, self._request_quit)
        if not self.is_headless and os.isatty(sys.stdin.fileno()):
            self.set_interval(TERMINAL_CHECK_INTERVAL, self._quit_without_terminal)

    def _quit_without_terminal(self) -> None:
        """Quit if the terminal closed without SIGHUP: Textual would read a closed terminal in a busy loop."""
        if not os.isatty(sys.stdin.fileno()):
            self._request_quit()

    def _request_quit(self) -> None:
        self.run_worker(self.action_quit(), exclusive=False)

    def get_line_filters(self) -> Sequence[LineFilter]:
        return (*super().get_line_filters(), self._control_char_filter)

    def get_key_display(self, binding: Binding) -> str:
        """Return the name of a key as the documentation writes it: F5, not f5."""
        key = super().get_key_display(binding)
        return key.upper() if key[1:].isdecimal() else key

    def get_driver_class(self) -> type[Driver]:
        driver = make_server_safe_driver(super().get_driver_class(), self._request_quit)
        return make_halt_driver(driver, self._halt_by_key)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        return bool(self._halts) if action == "halt" else True

    def add_halt_callback(self, halt: Callable[[], bool]) -> None:
        """Register a callback that stops the robot. The callback must not block and must not raise an
        exception. It returns True if it stopped a motion. Any thread may call the callback.
        """
        self._halts.append(halt)

    def halt(self) -> bool:
        """Call all HALT callbacks; return True if one of them stopped a motion. Any thread may call this."""
        return any([each() for each in tuple(self._halts)])

    def _halt_by_key(self) -> None:
        """Halt as soon as the terminal driver reads a HALT key; `action_halt` gets the key later."""
        self._last_halt = time.monotonic(), self.halt()

    def action_halt(self) -> None:
        """Stop all motion, unless `_halt_by_key` has just done so, and show a message."""
        halted_at, was_moving = self._last_halt
        if time.monotonic() - halted_at > HALT_KEY_WINDOW:
            was_moving = self.halt()
        self.show_message(label("shell.halted" if was_moving else "shell.halt.nothing"), "warning")

    async def action_quit(self) -> None:
        if self._is_ending:
            return
        self._is_ending = True
        try:
            await self._run_closers()
        finally:
            self.exit()

    async def _run_closers(self) -> None:
        """Run all closers within `CLOSE_TIMEOUT` seconds, even if one of them fails."""
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT):
                await self.closers.aclose()

    def run_until_closed(self) -> None:
        """Run the application until it is closed; after a bug, print the traceback and raise `SystemExit`."""
        try:
            self.run()
        finally:
            discard_unwritable_output()
        if self.return_code:
            raise SystemExit(self.return_code)

    async def run_async(self, **options: Any) -> None:
        """Run the application; run the closers even if a bug ends the application."""
        try:
            await super().run_async(**options)
        finally:
            await self._run_closers()

    def save_settings(self) -> None:
        try:
            write_settings(self.settings, self._settings_path)
        except OSError as error:
            text = label("shell.settings.unwritable", path=str(self._settings_path), reason=os_reason(error))
            self.show_message(text, "warning")

    def add_recent(self, item: str, recent: list[str]) -> None:
        """Put an item first in `recent`, a list of the settings, and save the settings."""
        recent[:] = with_recent(item, recent)
        self.save_settings()

    def copy_to_clipboard(self, text: str) -> None:
        """Copy to the clipboard; lone surrogates are escaped, because no clipboard accepts them."""
        super().copy_to_clipboard(text.encode(errors="backslashreplace").decode())

    def show_message(self, text: str, severity: SeverityLevel = "information") -> None:
        self.notify(text, severity=severity, markup=False)

    def action_help_quit(self) -> None:
        self.show_message(label("shell.quit.hint"))

    def action_next_theme(self) -> None:
        self.action_theme(THEME_NAMES[(THEME_NAMES.index(self.theme) + 1) % len(THEME_NAMES)])

    def action_theme(self, name: str) -> None:
        self._select_theme(name)
        self.settings.theme = self.theme
        self.save_settings()

    def action_language(self, name: str) -> None:
        """Save the language for the next start; texts on the screen keep the current language."""
        self.settings.language = name
        self.save_settings()
        self.show_message(label("shell.language.next"))


def app_of(node: DOMNode) -> BcapApp:
    return cast(BcapApp, node.app)
