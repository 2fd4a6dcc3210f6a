"""Driving the screen in tests: without a terminal, with a limit on everything, and pictures to compare."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

from textual.pilot import Pilot
from textual.widgets import Input

from bcapscope.tui.app import Scope, Spot
from bcapscope.tui.words import Language

LIMIT = 60.0
"""Seconds after which a test of the screen has failed."""

Act = Callable[[Pilot[None]], Awaitable[None]]
T = TypeVar("T")

Input.cursor_blink = False  # type: ignore[assignment]  # pictures must not depend on the moment


def drive(app: Scope, act: Act, size: tuple[int, int] = (80, 24), limit: float = LIMIT) -> None:
    """Run `act` on the screen, `size` being columns and rows, for `limit` seconds at most."""

    async def run() -> None:
        async with asyncio.timeout(limit), app.run_test(size=size) as pilot:
            app.animation_level = "none"
            await pilot.pause()
            await act(pilot)

    asyncio.run(run())


def make(*spots: Spot, language: Language = Language.ENGLISH, settings: Path | None = None) -> Scope:
    """Make the application; its settings lie in the folder of the test."""
    return Scope(spots, settings, language)


async def until(pilot: Pilot[None], true: Callable[[], object], limit: float = LIMIT) -> None:
    """Let the screen work until something is true.

    Raises:
        AssertionError: it did not become so in time.
    """
    end = time.monotonic() + limit
    while not true():
        assert time.monotonic() < end, f"still not so after {limit} s"
        await pilot.pause(0.01)
    await pilot.pause()


def picture(app: Scope) -> bytes:
    """Return what is shown as SVG, without what differs from run to run."""
    svg = app.export_screenshot(title="bcapscope")
    unique = sorted(set(re.findall(r"terminal-\d+", svg)))
    for name in unique:
        svg = svg.replace(name, "terminal")
    return svg.encode()


def shown(app: Scope) -> str:
    """Return what is shown as text, a line each."""
    width, height = app.size
    strips = app.screen._compositor.render_strips()
    return "\n".join(strip.text.rstrip() for strip in strips[:height]) + "\n" if width else ""
