"""Driving the screen that shows traffic in tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import Static

from bcapscope.messages import Language
from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from bcapscope.tui.widgets.bars import ViewBar
from tests.tui.pilot import Act, drive, make, until


@contextmanager
def shown(
    path: Path, follow: bool = False, settings: Path | None = None, language: Language = Language.ENGLISH
) -> Iterator[tuple[BcapApp, TrafficFeed]]:
    """Make the application with a capture; its processes are ended at the end."""
    feed = TrafficFeed(ReadJob(path=str(path), follow=follow))
    try:
        spot = ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, path.name))
        yield make(spot, language=language, settings=settings), feed
    finally:
        feed.close()


def act_on(path: Path, act: Act, size: tuple[int, int] = (80, 24)) -> None:
    """Show a capture, wait until all of it was read, and act."""
    with shown(path) as (app, feed):

        async def when_read(pilot: Pilot[None]) -> None:
            await read(pilot, feed)
            await act(pilot)

        drive(app, when_read, size)


async def read(pilot: Pilot[None], feed: TrafficFeed) -> None:
    """Wait until all was read and shown."""
    await until(pilot, lambda: feed.progress.ended)
    await until(pilot, lambda: not any("●" in text for text in screen(pilot).query_one(ViewBar)._states))


def screen(pilot: Pilot[None]) -> TrafficScreen:
    """Return the screen, whatever lies above it."""
    return next(each for each in pilot.app.screen_stack if isinstance(each, TrafficScreen))


def about(pilot: Pilot[None]) -> str:
    """Return what is said of the frame under the cursor."""
    return str(screen(pilot).query_one("#about", Static).content)
