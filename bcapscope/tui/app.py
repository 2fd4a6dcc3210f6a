"""The application: its screens, colours, settings, and how it ends."""

from __future__ import annotations

import asyncio
import gc
import math
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

from rich.style import Style
from textual.app import App
from textual.binding import Binding, BindingType
from textual.dom import DOMNode
from textual.driver import Driver
from textual.filter import LineFilter
from textual.reactive import reactive

from bcapscope.tui.browser_driver import make_server_safe_driver
from bcapscope.tui.control_char_filter import ControlCharFilter
from bcapscope.tui.halt_driver import HALT_KEYS, make_halt_driver
from bcapscope.tui.ink import Styles
from bcapscope.tui.key_order import KeyOrderApp
from bcapscope.tui.settings import default_settings_path, read_settings, write_settings
from bcapscope.tui.themes import THEMES, theme_styles
from bcapscope.tui.words import Language, say, speak, told

if TYPE_CHECKING:
    from bcapscope.tui.screens.base_screen import BaseScreen

CLOSE_TIMEOUT = 10.0
"""Seconds that all that is to be let go of may take; then the screen closes anyway."""

HALT_KEY_WINDOW = 0.5
"""Seconds in which a key that the driver has seen comes to us as well."""

TERMINAL_CHECK_INTERVAL = 1.0
"""Seconds from one look at the terminal to the next."""

_GC_THRESHOLDS = (2_000, 20, 1000)
"""How often to look for cycles, as no key is answered meanwhile: often among what is new, of which Textual's
strips are many (1 ms; 30 ms if ten times as many have gathered), rarely among everything (50 ms)."""

Closer = Callable[[], Awaitable[None]]


class ScreenEntry(NamedTuple):
    """A screen that one can go to.

    Attributes:
        mode: its name for the program.
        key: that goes there.
        name: key of its name in the catalogue of words.
        create: makes it when it is first gone to.
    """

    mode: str
    key: str
    name: str
    create: Callable[[], BaseScreen]


class BcapApp(KeyOrderApp):
    """The screen.

    Attributes:
        settings: what the user chose; `save_settings` writes it.
        status: what stands at the right of the bar at all times: texts, each with the name of its ink or "".
        text_styles: the styles of rendered lines under the theme.
    """

    CSS_PATH = ["bcapscope.tcss", "tester.tcss"]  # noqa: RUF012 - as Textual has it
    TITLE = "bcapscope"
    ENABLE_COMMAND_PALETTE = False
    """Textual's own offers what is Textual's; ours knows every action, see `BaseScreen`."""
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+q", "quit", "shell.quit", id="quit", priority=True, tooltip="shell.quit.tip"),
        Binding(HALT_KEYS[0], "halt", "shell.halt", id="halt", priority=True, tooltip="shell.halt.tip"),
        *(Binding(key, "halt", "", show=False, priority=True) for key in HALT_KEYS[1:]),
        Binding(
            "ctrl+t", "next_theme", "shell.next_theme", id="theme", show=False, tooltip="shell.theme.tip"
        ),
    ]
    status: reactive[tuple[tuple[str, str], ...]] = reactive((), init=False)

    def __init__(
        self,
        screen_entries: Sequence[ScreenEntry],
        settings_path: Path | None = None,
        language: Language | None = None,
    ) -> None:
        """Take the screens, the first of them shown first.

        Args:
            screen_entries: where one can go.
            settings_path: where settings are kept; in the platform's place unless given.
            language: of the labels, instead of what the settings or the environment say.
        """
        # Not a blank screen at first, as Textual has it: all styles would be read for that one, too.
        self.DEFAULT_MODE = screen_entries[0].mode  # type: ignore[misc]  # its place is the class, where there is one mode
        self._halts: list[Callable[[], bool]] = []  # before the driver that uses it is made
        self._last_halt = -math.inf, False
        self._control_char_filter = ControlCharFilter()
        super().__init__()
        self.screen_entries = tuple(screen_entries)
        self._settings_path = settings_path or default_settings_path()
        self.settings, self._settings_problem = read_settings(self._settings_path)
        if language is None and self.settings.language in tuple(Language):
            language = Language(self.settings.language)
        if language is not None:
            speak(language)
        self._closers: list[Closer] = []
        self._is_ending = False
        self._gc_thresholds = gc.get_threshold()
        for theme in THEMES:
            self.register_theme(theme)
        self.text_styles: Styles = {}
        self._select_theme(self.settings.theme)
        for spot in self.screen_entries:
            self.add_mode(spot.mode, spot.create)
            self.bind(spot.key, f"switch_mode('{spot.mode}')", description=spot.name, show=False)

    def _select_theme(self, name: str) -> None:
        names = [theme.name for theme in THEMES]
        name = name if name in names else names[0]
        if self.is_running:
            self.theme = name
            return
        # Not as it is done later: that reads all styles again, and there is nothing yet to draw anew.
        self.set_reactive(App.theme, name)
        is_dark = self.current_theme.dark
        self.set_class(is_dark, "-dark-mode", update=False)
        self.set_class(not is_dark, "-light-mode", update=False)
        self.stylesheet.set_variables(self.get_css_variables())
        self._update_text_styles()

    def _watch_theme(self, theme_name: str) -> None:
        super()._watch_theme(theme_name)
        self._update_text_styles()

    def _update_text_styles(self) -> None:
        inks = theme_styles(self.current_theme)
        if self.no_color:
            inks = {name: Style(bold=style.bold) for name, style in inks.items()} | {
                "lit": Style(reverse=True)
            }
        self.text_styles = inks

    def on_load(self) -> None:
        """Start tasks in turn on every Python.

        From Python 3.12 on, Textual's `App.run_async` has each task run at once. The first screen is then
        mounted before it is on the stack, and the first `Input` in it ends the program with a
        ScreenStackError.
        """
        asyncio.get_running_loop().set_task_factory(None)

    def on_mount(self) -> None:
        """Listen to signals, tell what was wrong with the settings."""
        self._install_signal_handlers()
        self.app_resume_signal.subscribe(self, lambda _: self.refresh(layout=True))
        gc.set_threshold(*_GC_THRESHOLDS)
        if self._settings_problem:
            text = say("shell.settings.broken", path=self._settings_path, reason=told(self._settings_problem))
            self.show_message(text, "warning")

    def on_unmount(self) -> None:
        """Look for garbage as before, also in what the screens had set aside."""
        gc.unfreeze()
        gc.set_threshold(*self._gc_thresholds)

    def _install_signal_handlers(self) -> None:
        """Close in order when the terminal is closed or the program is asked to end."""
        if sys.platform == "win32":
            return
        loop = asyncio.get_running_loop()
        for number in (signal.SIGHUP, signal.SIGTERM):
            loop.add_signal_handler(number, self._request_quit)
        if not self.is_headless and os.isatty(sys.stdin.fileno()):
            self.set_interval(TERMINAL_CHECK_INTERVAL, self._quit_without_terminal)

    def _quit_without_terminal(self) -> None:
        """Close in order when the terminal is gone: SIGHUP comes only to those whose own it was.

        Textual would go on reading the end of its input as fast as it can.
        """
        if not os.isatty(sys.stdin.fileno()):
            self._request_quit()

    def _request_quit(self) -> None:
        self.run_worker(self.action_quit(), exclusive=False)

    def add_closer(self, closer: Closer) -> None:
        """Have something done before the screen closes, however it is closed; the last is done first."""
        self._closers.append(closer)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Return what every line passes through on its way to the terminal."""
        before = tuple(super().get_line_filters())
        if before != self._control_char_filter.earlier_filters:
            self._control_char_filter = ControlCharFilter(before)
        return (self._control_char_filter,)

    def get_key_display(self, binding: Binding) -> str:
        """Write a key as everywhere else: F5, not f5."""
        key = super().get_key_display(binding)
        return key.upper() if key[1:].isdecimal() else key

    def get_driver_class(self) -> type[Driver]:
        """Return the platform's driver or that of browsers, which knows the keys of HALT."""
        driver = make_server_safe_driver(super().get_driver_class(), self._request_quit)
        return make_halt_driver(driver, self._halt_by_key)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer HALT only where there is something to halt."""
        return bool(self._halts) if action == "halt" else True

    def add_halt_callback(self, halt: Callable[[], bool]) -> None:
        """Have something stopped by HALT.

        Args:
            halt: called in any thread; returns at once whether there was something to stop; must not raise.
        """
        self._halts.append(halt)

    def halt(self) -> bool:
        """Stop everything that moves; return whether there was something. From any thread."""
        return any([each() for each in tuple(self._halts)])

    def _halt_by_key(self) -> None:
        """Halt as soon as the driver reads the key, which comes to `action_halt` as well."""
        self._last_halt = time.monotonic(), self.halt()

    def action_halt(self) -> None:
        """Stop everything that moves, and say so; not twice where the driver has just done it."""
        at, was_there = self._last_halt
        if time.monotonic() - at > HALT_KEY_WINDOW:
            was_there = self.halt()
        self.show_message(say("shell.halted" if was_there else "shell.halt.nothing"), "warning")

    async def action_quit(self) -> None:
        """Let go of everything, then close."""
        if self._is_ending:
            return
        self._is_ending = True
        try:
            await self._run_closers()
        finally:
            self.exit()

    async def _run_closers(self) -> None:
        """Do all that is to be done at the end; an error in one keeps nobody from the others."""
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT), AsyncExitStack() as stack:
                for closer in self._closers:
                    stack.push_async_callback(closer)
                self._closers.clear()

    def run_until_closed(self) -> None:
        """Run the screen until it is closed.

        Raises:
            SystemExit: an error of ours ended it, which stands on the terminal.
        """
        self.run()
        if self.return_code:
            raise SystemExit(self.return_code)

    async def run_async(self, **options: Any) -> None:
        """Run, and let go of everything where an error of ours has ended it."""
        try:
            await super().run_async(**options)
        finally:
            await self._run_closers()

    def save_settings(self) -> None:
        """Write the settings; tell if that is not possible."""
        try:
            write_settings(self.settings, self._settings_path)
        except OSError as error:
            reason = told(error.strerror or str(error))
            text = say("shell.settings.unwritable", path=self._settings_path, reason=reason)
            self.show_message(text, "warning")

    def copy_to_clipboard(self, text: str) -> None:
        """Copy to the clipboard; half a character (a lone surrogate), which none takes, is written out."""
        super().copy_to_clipboard(text.encode(errors="backslashreplace").decode())

    def show_message(self, text: str, severity: str = "information") -> None:
        """Show a message for a while; `text` is never taken for markup."""
        kind = severity if severity in ("warning", "error") else "information"
        self.notify(text, severity=kind, markup=False)  # type: ignore[arg-type]  # it is one of the three

    def action_help_quit(self) -> None:
        """Tell whoever presses Ctrl-C, which is a key like others here, how to end."""
        self.show_message(say("shell.quit.hint"))

    def action_next_theme(self) -> None:
        """Go on to the next theme."""
        names = [theme.name for theme in THEMES]
        self.action_theme(names[(names.index(self.theme) + 1) % len(names)])

    def action_theme(self, name: str) -> None:
        """Choose a theme and remember it."""
        self._select_theme(name)
        self.settings.theme = self.theme
        self.save_settings()

    def action_language(self, name: str) -> None:
        """Remember the language, for the next start: what is shown was made in the present one."""
        self.settings.language = name
        self.save_settings()
        self.show_message(say("shell.language.next"))


def app_of(node: DOMNode) -> BcapApp:
    """Return the application that a widget is shown by."""
    return cast(BcapApp, node.app)
