"""What stands behind other widgets is drawn as Textual would draw it."""

from __future__ import annotations

import pytest
from textual.geometry import Region
from textual.pilot import Pilot
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from bcapscope.tui.widgets.plain_containers import PlainContainer, PlainVertical
from tests.tui.widgets.stage import on_stage


def drawn(strip: Strip) -> list[tuple[str, object]]:
    """Tell what is seen of a blank line: the colour of letters, of which there are none, does not count."""
    simple = strip.simplify()
    return [(text, style and style.bgcolor) for text, style, _ in simple]


@pytest.mark.parametrize("colours", [True, False])
def test_the_ground_is_as_textual_draws_it(colours: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not colours:
        monkeypatch.setenv("NO_COLOR", "1")

    async def act(pilot: Pilot[None]) -> None:
        grounds = [
            each
            for each in pilot.app.screen.walk_children(with_self=True)
            if isinstance(each, PlainContainer)
        ]
        assert len(grounds) == 2
        for ground in grounds:
            crop = Region(3, 2, ground.size.width - 5, ground.size.height - 4)
            assert [drawn(strip) for strip in ground.render_lines(crop)] == [
                drawn(strip) for strip in Widget.render_lines(ground, crop)
            ]

    on_stage(lambda: PlainVertical(Static("seen")), act)
