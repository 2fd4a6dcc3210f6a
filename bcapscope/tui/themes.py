"""The three themes: light, dark, and one that people with any kind of colour vision can use.

The third theme uses the colours of Okabe and Ito 2008, "Color Universal Design"; success is blue and failure
is orange. No theme conveys anything by colour alone.
"""

from __future__ import annotations

from rich.style import Style
from textual.color import Color
from textual.theme import Theme

from bcapscope.tui.ink import Styles

_STYLE_KEYS = ("number", "name", "hex", "problem", "good", "bad", "dim")


def _style_variables(*colors: str) -> dict[str, str]:
    """Return the theme variables for the colours of rendered lines, in the order of `_STYLE_KEYS`."""
    return {f"ink-{key}": value for key, value in zip(_STYLE_KEYS, colors, strict=True)}


THEMES = (
    Theme(
        name="dark",
        primary="#5fafd7",
        secondary="#87afaf",
        accent="#ffaf5f",
        success="#87d787",
        warning="#ffd75f",
        error="#ff6f6f",
        foreground="#d7dce2",
        background="#14181d",
        surface="#1a1f26",
        panel="#242b34",
        dark=True,
        variables={
            **_style_variables("#87d7ff", "#ffffff", "#9fb4cc", "#ff8f6f", "#87d787", "#ff6f6f", "#8794a3"),
            "ink-lit": "#ffe9a8 on #5a4a12",
            "ink-cursor": "#14181d on #ffd75f",
            "border": "#3b4654",
            "block-cursor-background": "#2f5d7e",
            "block-cursor-foreground": "#ffffff",
            "block-cursor-text-style": "none",
            "block-cursor-blurred-background": "#2a323c",
            "block-cursor-blurred-foreground": "#d7dce2",
        },
    ),
    Theme(
        name="light",
        primary="#005f87",
        secondary="#48696f",
        accent="#955000",
        success="#1a6e1a",
        warning="#7a5600",
        error="#b00020",
        foreground="#1c2127",
        background="#fbfbf9",
        surface="#f3f3ef",
        panel="#e6e7e2",
        dark=False,
        variables={
            **_style_variables("#00507a", "#000000", "#3d4f66", "#a03800", "#1a6e1a", "#b00020", "#5f666d"),
            "ink-lit": "#000000 on #ffe9a6",
            "ink-cursor": "#000000 on #ffb000",
            "border": "#b9bdb5",
            "block-cursor-background": "#bfdcec",
            "block-cursor-foreground": "#000000",
            "block-cursor-text-style": "none",
            "block-cursor-blurred-background": "#e0e4e0",
            "block-cursor-blurred-foreground": "#1c2127",
        },
    ),
    Theme(
        name="safe",
        primary="#56b4e9",
        secondary="#00a478",
        accent="#f0e442",
        success="#56b4e9",
        warning="#f0e442",
        error="#e69f00",
        foreground="#e8e8e8",
        background="#101010",
        surface="#181818",
        panel="#262626",
        dark=True,
        variables={
            **_style_variables("#a8d8f0", "#ffffff", "#b8b8b8", "#f0e442", "#56b4e9", "#e69f00", "#8e8e8e"),
            "ink-lit": "#f7f2a8 on #5c5714",
            "ink-cursor": "#000000 on #f0e442",
            "border": "#484848",
            "block-cursor-background": "#005a8c",
            "block-cursor-foreground": "#ffffff",
            "block-cursor-text-style": "none",
            "block-cursor-blurred-background": "#303030",
            "block-cursor-blurred-foreground": "#e8e8e8",
        },
    ),
)

_MIN_CONTRAST = 4.5
"""Minimum contrast ratio of text and background (WCAG 2.2)."""

_BLEND_STEPS = 20

_BOLD = frozenset({"name", "problem", "bad"})


def theme_styles(theme: Theme) -> Styles:
    """Return the styles that a theme gives to rendered lines, by style name."""
    prefix = "ink-"
    found = {
        key.removeprefix(prefix): Style.parse(value)
        for key, value in theme.variables.items()
        if key.startswith(prefix)
    }
    return {key: style + Style(bold=True) if key in _BOLD else style for key, style in found.items()}


def readable_style(style: Style, background: Style) -> Style:
    """Return a style whose colour is blended towards the background's text colour until it is readable."""
    both = background + style
    if (
        style.color is None
        or style.bgcolor is not None
        or background.color is None
        or background.bgcolor is None
    ):
        return both
    color, own, behind = map(Color.from_rich_color, (style.color, background.color, background.bgcolor))
    mixed = (color.blend(own, step / _BLEND_STEPS) for step in range(_BLEND_STEPS + 1))
    found = next((each for each in mixed if contrast(each, behind) >= _MIN_CONTRAST), own)
    return both + Style.from_color(found.rich_color)


def contrast(one: Color, other: Color) -> float:
    """Return the contrast ratio of two colours, 1 to 21 (WCAG 2.2)."""
    light, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def _luminance(color: Color) -> float:
    parts = (part / 255 for part in color.rgb)
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
