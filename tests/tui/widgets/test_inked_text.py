"""Rendered text in the colours of the theme."""

from __future__ import annotations

from textual.pilot import Pilot

from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.text_widgets import InkedText
from tests.tui.pilot import until
from tests.tui.widgets.stage import on_stage, scope


def test_another_theme_draws_it_anew() -> None:
    async def act(pilot: Pilot[None]) -> None:
        app = scope(pilot)
        text = app.screen.query_one(InkedText)
        text.show_text(f"{INK.name}name{INK.reset} rest")
        for theme in ("light", "dark", "safe"):
            app.theme = theme
            wanted = app.text_styles["name"].color
            await until(pilot, lambda wanted=wanted: colour(text) == wanted)  # type: ignore[misc]

    on_stage(InkedText, act)


def colour(text: InkedText) -> object:
    """Return the colour of the first letter, as it is drawn."""
    style = next(iter(text.render_line(0))).style
    return style and style.color
