"""Pictures of the main screens, which the documentation shows; ``pytest --golden-write`` makes them anew."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot

from tests.cli.run import CAPTURES
from tests.tui.pilot import drive, picture, until
from tests.tui.showing import read, screen, shown

PICTURES = Path(__file__).parent.parent.parent / "docs" / "pictures"


FRAMES = ("slave-session.pcapng", ("ctrl+g", "2", "7", "enter", "enter", *["down"] * 13))


@pytest.mark.parametrize(
    ("name", "theme", "capture", "keys"),
    [
        ("frames-dark", "dark", *FRAMES),
        ("frames-light", "light", *FRAMES),
        ("frames-safe", "safe", *FRAMES),
        ("calls", "dark", "retry-story.pcapng", ("2", "right", "down", "down", "down", "down")),
        ("findings", "light", "slave-mode-lost.pcapng", ("3",)),
    ],
)
def test_pictures_are_as_they_were(
    name: str, theme: str, capture: str, keys: tuple[str, ...], request: pytest.FixtureRequest
) -> None:
    made = []
    with shown(CAPTURES / capture) as (app, feed):

        async def act(pilot: Pilot[None]) -> None:
            await read(pilot, feed)
            app.theme = theme
            for key in keys:
                await pilot.press(key)
                await pilot.pause()
            await until(pilot, lambda: app.screen is screen(pilot))
            made.append(picture(app))

        drive(app, act, (110, 32))
    path = PICTURES / f"{name}.svg"
    if request.config.getoption("--golden-write"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(made[0])
    assert made[0].decode() == path.read_text(), "look at the pictures that --golden-write makes"
