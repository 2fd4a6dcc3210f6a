"""The themes. No theme conveys anything by colour alone. The theme "safe" is for people with any kind of
colour vision. The colours of "safe" come from Okabe and Ito 2008, "Color Universal Design".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from rich.style import Style
from textual.color import Color
from textual.theme import Theme

from bcapscope.tui.ink import Styles

_TABLE = """
                                 dark                light               safe
primary                          #5fafd7             #005f87             #56b4e9
secondary                        #87afaf             #48696f             #00a478
accent                           #ffaf5f             #955000             #f0e442
success                          #87d787             #1a6e1a             #56b4e9
warning                          #ffd75f             #7a5600             #f0e442
error                            #ff6f6f             #b00020             #e69f00
foreground                       #d7dce2             #1c2127             #e8e8e8
background                       #14181d             #fbfbf9             #101010
surface                          #1a1f26             #f3f3ef             #181818
panel                            #242b34             #e6e7e2             #262626
ink-number                       #87d7ff             #00507a             #a8d8f0
ink-name                         #ffffff             #000000             #ffffff
ink-hex                          #9fb4cc             #3d4f66             #b8b8b8
ink-problem                      #ff8f6f             #a03800             #f0e442
ink-good                         #87d787             #1a6e1a             #56b4e9
ink-bad                          #ff6f6f             #b00020             #e69f00
ink-dim                          #8794a3             #5f666d             #8e8e8e
ink-lit                          #ffe9a8 on #5a4a12  #000000 on #ffe9a6  #f7f2a8 on #5c5714
ink-cursor                       #14181d on #ffd75f  #000000 on #ffb000  #000000 on #f0e442
border                           #3b4654             #b9bdb5             #484848
block-cursor-background          #2f5d7e             #bfdcec             #005a8c
block-cursor-foreground          #ffffff             #000000             #ffffff
block-cursor-blurred-background  #2a323c             #e0e4e0             #303030
block-cursor-blurred-foreground  #d7dce2             #1c2127             #e8e8e8
"""
"""Each row is one colour, and each column is one theme. The rows "ink-…" are styles of rendered lines."""

_VARIABLE_PREFIXES = ("ink-", "border", "block-")  # variables of the style sheet


def _read_themes() -> Iterator[Theme]:
    (*names,), *rows = (re.split(" {2,}", line.strip()) for line in _TABLE.strip().splitlines())
    for column, name in enumerate(names, 1):
        colors: dict[str, Any] = {row[0]: row[column] for row in rows}
        variables = {key: colors.pop(key) for key in tuple(colors) if key.startswith(_VARIABLE_PREFIXES)}
        variables["block-cursor-text-style"] = "none"
        yield Theme(name, dark=name != "light", variables=variables, **colors)


THEMES = tuple(_read_themes())
THEME_NAMES = [theme.name for theme in THEMES]

_MIN_CONTRAST = 4.5
"""Minimum contrast ratio of text and background (WCAG 2.2)."""

_BLEND_STEPS = 20

_BOLD = frozenset({"name", "problem", "bad"})


def theme_styles(theme: Theme) -> Styles:
    found = {key.removeprefix("ink-"): value for key, value in theme.variables.items() if "ink-" in key}
    return {key: Style.parse(f"bold {value}" if key in _BOLD else value) for key, value in found.items()}


def readable_style(style: Style, background: Style) -> Style:
    """Mix the colour of `style` with the text colour of `background` until the contrast is sufficient."""
    both = background + style
    if style.bgcolor or not (style.color and background.color and background.bgcolor):
        return both
    color, own, behind = map(Color.from_rich_color, (style.color, background.color, background.bgcolor))
    blends = (color.blend(own, step / _BLEND_STEPS) for step in range(_BLEND_STEPS + 1))
    found = next((each for each in blends if contrast(each, behind) >= _MIN_CONTRAST), own)
    return both + Style.from_color(found.rich_color)


def contrast(one: Color, other: Color) -> float:
    """Return the contrast ratio, 1 to 21 (WCAG 2.2)."""
    light, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def _luminance(color: Color) -> float:
    parts = (part / 255 for part in color.rgb)
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
