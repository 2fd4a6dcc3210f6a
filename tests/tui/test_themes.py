"""Themes that can be read, by everyone."""

from __future__ import annotations

import pytest
from textual.color import Color
from textual.theme import Theme

from bcapscope.tui.themes import THEMES

INKS = ("number", "name", "hex", "problem", "good", "bad", "dim")


def contrast(one: Color, other: Color) -> float:
    """Return the contrast ratio of two colours, 1 to 21 (WCAG 2.2)."""

    def luminance(color: Color) -> float:
        parts = (part / 255 for part in color.rgb)
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", THEMES, ids=lambda theme: theme.name)
@pytest.mark.parametrize("ink", INKS)
def test_every_ink_can_be_read_on_the_ground(theme: Theme, ink: str) -> None:
    ground = Color.parse(theme.background or "")
    wanted = 4.5 if ink != "dim" else 4.0
    assert contrast(Color.parse(theme.variables[f"ink-{ink}"]), ground) >= wanted


def test_good_and_bad_differ_for_those_who_see_no_red_or_green() -> None:
    (safe,) = (theme for theme in THEMES if theme.name == "safe")
    good, bad = (Color.parse(safe.variables[f"ink-{ink}"]) for ink in ("good", "bad"))
    assert abs(good.b - bad.b) > 100
