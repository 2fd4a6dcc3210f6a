"""Driving the screen in tests: without a terminal, with a limit on everything, and pictures to compare."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import textual.app
import textual.pilot
from textual._context import visible_screen_stack
from textual.pilot import Pilot
from textual.widgets import Input

from bcapscope.messages import Language
from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.reader_language import set_language

LIMIT = 60.0
"""Seconds after which a test of the screen has failed."""

_LOOK = 0.02
"""Seconds from one look at what is waited for to the next."""

_TURNS, _DRAWINGS = 50, 4
"""How often all tasks get a turn, and all is drawn, before a screen is left that moves by itself."""

Act = Callable[[Pilot[None]], Awaitable[None]]
T = TypeVar("T")

Input.cursor_blink = False  # type: ignore[assignment]  # pictures must not depend on the moment


async def quiet(min_sleep: float = 0, max_sleep: float = 0) -> None:
    """Let everything work until each task waits: for a key, the time, a thread or another process.

    Textual's own, which has these arguments, takes a process for quiet that uses little of the processor: on
    a busy machine that is one that does not get it.
    """
    ready = cast(Any, asyncio.get_running_loop())._ready
    for turn in range(_TURNS):
        await asyncio.sleep(0)
        if turn and not ready:  # what came in from outside is ready only after a look there
            break


for _module in (textual.app, textual.pilot):
    vars(_module)["wait_for_idle"] = quiet


class Hand(Pilot[None]):
    """Presses a key when what the key before has done is drawn."""

    async def press(self, *keys: str) -> None:
        """Press keys, one after the other."""
        for key in keys:
            await self.app._press_keys([key])
            await self._reached()
            await self._wait_for_screen()

    async def _reached(self) -> None:
        """Wait until the key has gone its way: to the application, to what has the focus, and back up.

        Who gets it may be waiting for a thread, which looks as quiet as having done with it.
        """
        for place in (self.app, self.app.focused, self.app.screen, self.app):
            done = asyncio.Event()
            if place is not None and place.call_later(done.set):
                async with asyncio.timeout(LIMIT):
                    await done.wait()

    async def resize_terminal(self, width: int, height: int) -> None:
        """Make the terminal another size; Textual waits for a moment before it takes that."""
        await super().resize_terminal(width, height)
        await until(self, lambda: self.app._resize_event is None)

    async def _wait_for_screen(self, timeout: float = LIMIT) -> bool:
        """Let everything be done and drawn that was begun; return whether it could be."""
        async with asyncio.timeout(timeout):
            await quiet()
            for _ in range(_DRAWINGS):
                if not self._draw():
                    break
                await quiet()
        return self.app._exception is None

    def _draw(self) -> bool:
        """Draw what a timer would draw after a sixtieth of a second; tell whether there was anything."""
        stack = [screen for screen in self.app.screen_stack if screen.is_running]
        waiting = [screen for screen in stack if screen._update_timer._active.is_set()]
        for screen in waiting:
            screen._on_timer_update()
        return bool(waiting)


def drive(app: BcapApp, act: Act, size: tuple[int, int] = (80, 24), limit: float = LIMIT) -> None:
    """Run `act` on the screen, `size` being columns and rows, for `limit` seconds at most; quit then."""

    async def run() -> None:
        async with asyncio.timeout(limit), app.run_test(size=size):
            app.animation_level = "none"
            pilot = Hand(app)
            await pilot.pause()
            try:
                await act(pilot)
            finally:
                await app.action_quit()

    asyncio.run(run())


def make(*spots: ScreenEntry, language: Language = Language.ENGLISH, settings: Path | None = None) -> BcapApp:
    """Make the application; its settings lie in the folder of the test."""
    set_language(language)
    return BcapApp(spots, settings)


async def until(pilot: Pilot[None], true: Callable[[], object], limit: float = LIMIT) -> None:
    """Let the screen work until something is true.

    Raises:
        AssertionError: it did not become so in time.
    """
    end = time.monotonic() + limit
    while not true():
        assert time.monotonic() < end, f"still not so after {limit} s"
        await asyncio.sleep(_LOOK)
    await pilot.pause()


def picture(app: BcapApp) -> bytes:
    """Return what is shown as SVG, without what differs from run to run."""
    svg = app.export_screenshot(title="bcapscope")
    unique = sorted(set(re.findall(r"terminal-\d+", svg)))
    for name in unique:
        svg = svg.replace(name, "terminal")
    return svg.encode()


def shown(app: BcapApp) -> str:
    """Return what is shown as text, a line each."""
    width, height = app.size
    visible_screen_stack.set(
        app._background_screens
    )  # else a dialog is drawn, and kept, with nothing behind it
    strips = app.screen._compositor.render_strips()
    return "\n".join(strip.text.rstrip() for strip in strips[:height]) + "\n" if width else ""
