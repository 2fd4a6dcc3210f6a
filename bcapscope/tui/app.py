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

from bcapscope.tui.browser import outlasting_server
from bcapscope.tui.halting import HALT_KEYS, halting
from bcapscope.tui.harmless import Harmless
from bcapscope.tui.ink import Styles
from bcapscope.tui.keyorder import KeyOrder
from bcapscope.tui.settings import default_path, load, save
from bcapscope.tui.themes import THEMES, styles_of
from bcapscope.tui.words import Language, say, speak, told

if TYPE_CHECKING:
    from bcapscope.tui.screens.place import Place

CLOSING_LIMIT = 10.0
"""Seconds that all that is to be let go of may take; then the screen closes anyway."""

SAME_HALT = 0.5
"""Seconds in which a key that the driver has seen comes to us as well."""

LOOK_EACH = 1.0
"""Seconds from one look at the terminal to the next."""

_GARBAGE = (2_000, 20, 1000)
"""How often to look for cycles, as no key is answered meanwhile: often among what is new, of which Textual's
strips are many (1 ms; 30 ms if ten times as many have gathered), rarely among everything (50 ms)."""

Closer = Callable[[], Awaitable[None]]


class Spot(NamedTuple):
    """A screen that one can go to.

    Attributes:
        mode: its name for the program.
        key: that goes there.
        name: key of its name in the catalogue of words.
        make: makes it when it is first gone to.
    """

    mode: str
    key: str
    name: str
    make: Callable[[], Place]


class Scope(KeyOrder):
    """The screen.

    Attributes:
        settings: what the user chose; `keep` writes it.
        status: what stands at the right of the bar at all times: texts, each with the name of its ink or "".
        inks: the styles of rendered lines under the theme.
    """

    CSS_PATH = ["bcapscope.tcss", "tester.tcss"]  # noqa: RUF012 - as Textual has it
    TITLE = "bcapscope"
    ENABLE_COMMAND_PALETTE = False
    """Textual's own offers what is Textual's; ours knows every action, see `Place`."""
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
        self, spots: Sequence[Spot], settings_path: Path | None = None, language: Language | None = None
    ) -> None:
        """Take the screens, the first of them shown first.

        Args:
            spots: where one can go.
            settings_path: where settings are kept; in the platform's place unless given.
            language: of the labels, instead of what the settings or the environment say.
        """
        # Not a blank screen at first, as Textual has it: all styles would be read for that one, too.
        self.DEFAULT_MODE = spots[0].mode  # type: ignore[misc]  # its place is the class, where there is one mode
        self._halts: list[Callable[[], bool]] = []  # before the driver that uses it is made
        self._halted = -math.inf, False
        self._harmless = Harmless()
        super().__init__()
        self.spots = tuple(spots)
        self._settings_path = settings_path or default_path()
        self.settings, self._trouble = load(self._settings_path)
        if language is None and self.settings.language in tuple(Language):
            language = Language(self.settings.language)
        if language is not None:
            speak(language)
        self._closers: list[Closer] = []
        self._is_ending = False
        self._thresholds = gc.get_threshold()
        for theme in THEMES:
            self.register_theme(theme)
        self.inks: Styles = {}
        self._take_theme(self.settings.theme)
        for spot in self.spots:
            self.add_mode(spot.mode, spot.make)
            self.bind(spot.key, f"switch_mode('{spot.mode}')", description=spot.name, show=False)

    def _take_theme(self, name: str) -> None:
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
        self._take_inks()

    def _watch_theme(self, theme_name: str) -> None:
        super()._watch_theme(theme_name)
        self._take_inks()

    def _take_inks(self) -> None:
        inks = styles_of(self.current_theme)
        if self.no_color:
            inks = {name: Style(bold=style.bold) for name, style in inks.items()} | {
                "lit": Style(reverse=True)
            }
        self.inks = inks

    def on_load(self) -> None:
        """Start tasks in turn on every Python.

        From Python 3.12 on, Textual's `App.run_async` has each task run at once. The first screen is then
        mounted before it is on the stack, and the first `Input` in it ends the program with a
        ScreenStackError.
        """
        asyncio.get_running_loop().set_task_factory(None)

    def on_mount(self) -> None:
        """Listen to signals, tell what was wrong with the settings."""
        self._listen()
        self.app_resume_signal.subscribe(self, lambda _: self.refresh(layout=True))
        gc.set_threshold(*_GARBAGE)
        if self._trouble:
            text = say("shell.settings.broken", path=self._settings_path, reason=told(self._trouble))
            self.tell(text, "warning")

    def on_unmount(self) -> None:
        """Look for garbage as before, also in what the screens had set aside."""
        gc.unfreeze()
        gc.set_threshold(*self._thresholds)

    def _listen(self) -> None:
        """Close in order when the terminal is closed or the program is asked to end."""
        if sys.platform == "win32":
            return
        loop = asyncio.get_running_loop()
        for number in (signal.SIGHUP, signal.SIGTERM):
            loop.add_signal_handler(number, self._asked_to_end)
        if not self.is_headless and os.isatty(sys.stdin.fileno()):
            self.set_interval(LOOK_EACH, self._look_for_terminal)

    def _look_for_terminal(self) -> None:
        """Close in order when the terminal is gone: SIGHUP comes only to those whose own it was.

        Textual would go on reading the end of its input as fast as it can.
        """
        if not os.isatty(sys.stdin.fileno()):
            self._asked_to_end()

    def _asked_to_end(self) -> None:
        self.run_worker(self.action_quit(), exclusive=False)

    def at_close(self, closer: Closer) -> None:
        """Have something done before the screen closes, however it is closed; the last is done first."""
        self._closers.append(closer)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Return what every line passes through on its way to the terminal."""
        before = tuple(super().get_line_filters())
        if before != self._harmless.before:
            self._harmless = Harmless(before)
        return (self._harmless,)

    def get_key_display(self, binding: Binding) -> str:
        """Write a key as everywhere else: F5, not f5."""
        key = super().get_key_display(binding)
        return key.upper() if key[1:].isdecimal() else key

    def get_driver_class(self) -> type[Driver]:
        """Return the platform's driver or that of browsers, which knows the keys of HALT."""
        driver = outlasting_server(super().get_driver_class(), self._asked_to_end)
        return halting(driver, self._halt_by_key)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer HALT only where there is something to halt."""
        return bool(self._halts) if action == "halt" else True

    def at_halt(self, halt: Callable[[], bool]) -> None:
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
        self._halted = time.monotonic(), self.halt()

    def action_halt(self) -> None:
        """Stop everything that moves, and say so; not twice where the driver has just done it."""
        at, was_there = self._halted
        if time.monotonic() - at > SAME_HALT:
            was_there = self.halt()
        self.tell(say("shell.halted" if was_there else "shell.halt.nothing"), "warning")

    async def action_quit(self) -> None:
        """Let go of everything, then close."""
        if self._is_ending:
            return
        self._is_ending = True
        try:
            await self._let_go()
        finally:
            self.exit()

    async def _let_go(self) -> None:
        """Do all that is to be done at the end; an error in one keeps nobody from the others."""
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSING_LIMIT), AsyncExitStack() as stack:
                for closer in self._closers:
                    stack.push_async_callback(closer)
                self._closers.clear()

    def show(self) -> None:
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
            await self._let_go()

    def keep(self) -> None:
        """Write the settings; tell if that is not possible."""
        try:
            save(self.settings, self._settings_path)
        except OSError as error:
            reason = told(error.strerror or str(error))
            text = say("shell.settings.unwritable", path=self._settings_path, reason=reason)
            self.tell(text, "warning")

    def copy_to_clipboard(self, text: str) -> None:
        """Copy to the clipboard; half a character (a lone surrogate), which none takes, is written out."""
        super().copy_to_clipboard(text.encode(errors="backslashreplace").decode())

    def tell(self, text: str, severity: str = "information") -> None:
        """Show a message for a while; `text` is never taken for markup."""
        kind = severity if severity in ("warning", "error") else "information"
        self.notify(text, severity=kind, markup=False)  # type: ignore[arg-type]  # it is one of the three

    def action_help_quit(self) -> None:
        """Tell whoever presses Ctrl-C, which is a key like others here, how to end."""
        self.tell(say("shell.quit.hint"))

    def action_next_theme(self) -> None:
        """Go on to the next theme."""
        names = [theme.name for theme in THEMES]
        self.action_theme(names[(names.index(self.theme) + 1) % len(names)])

    def action_theme(self, name: str) -> None:
        """Choose a theme and remember it."""
        self._take_theme(name)
        self.settings.theme = self.theme
        self.keep()

    def action_language(self, name: str) -> None:
        """Remember the language, for the next start: what is shown was made in the present one."""
        self.settings.language = name
        self.keep()
        self.tell(say("shell.language.next"))


def scope_of(node: DOMNode) -> Scope:
    """Return the application that a widget is shown by."""
    return cast(Scope, node.app)
