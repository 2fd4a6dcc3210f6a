"""Themes that can be read, by everyone."""

from __future__ import annotations

import pytest
from rich.style import Style
from textual.color import Color
from textual.theme import Theme

from bcapscope.tui.themes import THEMES, contrast, readable_style, theme_styles

INKS = ("number", "name", "hex", "problem", "good", "bad", "dim")


@pytest.mark.parametrize("theme", THEMES, ids=lambda theme: theme.name)
def test_every_ink_and_colour_can_be_read_on_the_ground_and_on_bars(theme: Theme) -> None:
    inks = {ink: theme.variables[f"ink-{ink}"] for ink in INKS}
    colours = {name: str(getattr(theme, name)) for name in ("foreground", "primary", "secondary", "accent")}
    for ground in (theme.background, theme.surface, theme.panel):
        for name, colour in (inks | colours).items():
            assert contrast(Color.parse(colour), Color.parse(ground or "")) >= 4.5, (name, ground)


@pytest.mark.parametrize("theme", THEMES, ids=lambda theme: theme.name)
@pytest.mark.parametrize("ground", ["cursor", "cursor-blurred"])
def test_every_ink_can_be_read_on_the_line_of_the_cursor(theme: Theme, ground: str) -> None:
    letters, behind = (
        Color.parse(theme.variables[f"block-{ground}-{which}"]) for which in ("foreground", "background")
    )
    own = Style(color=letters.rich_color, bgcolor=behind.rich_color)
    for ink, style in theme_styles(theme).items():
        drawn = readable_style(style, own)
        assert drawn.color is not None
        assert drawn.bgcolor is not None
        assert contrast(*map(Color.from_rich_color, (drawn.color, drawn.bgcolor))) >= 4.5, ink


def test_the_contrast_of_black_and_white_is_the_largest() -> None:
    assert contrast(Color.parse("#000000"), Color.parse("#ffffff")) == pytest.approx(21)
    assert contrast(Color.parse("#777777"), Color.parse("#ffffff")) == pytest.approx(4.48, abs=0.01)


def test_good_and_bad_differ_for_those_who_see_no_red_or_green() -> None:
    (safe,) = (theme for theme in THEMES if theme.name == "safe")
    good, bad = (Color.parse(safe.variables[f"ink-{ink}"]) for ink in ("good", "bad"))
    assert abs(good.b - bad.b) > 100
