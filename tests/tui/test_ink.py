"""Colours of rendered lines."""

from __future__ import annotations

from dataclasses import fields

from hypothesis import given
from hypothesis import strategies as st
from rich.style import Style

from bcapscope.render.color_palette import PLAIN
from bcapscope.render.escape import printable
from bcapscope.tui.ink import (
    CURSOR,
    INK,
    LIT,
    STYLE_NAMES,
    styled_pieces,
    styled_segments,
    styled_text,
)
from bcapscope.tui.themes import THEMES, theme_styles
from tests.tui.marks import strip_styles


def test_a_line_falls_into_pieces() -> None:
    line = f"a {INK.bad}E_FAIL{INK.reset} b {LIT}01{CURSOR}02{INK.reset}"
    found = [("", "a "), ("bad", "E_FAIL"), ("", " b "), ("lit", "01"), ("cursor", "02")]
    assert list(styled_pieces(line)) == found
    assert strip_styles(line) == "a E_FAIL b 0102"
    assert styled_text(line, {}).plain == strip_styles(line)


def test_segments_have_the_styles_of_the_theme() -> None:
    red = Style(color="red")
    (first, second) = styled_segments(f"{INK.bad}no{INK.reset} yes", {"bad": red})
    assert (first.style, second.style) == (red, None)


@given(st.text())
def test_no_text_from_the_wire_is_a_mark(text: str) -> None:
    assert list(styled_pieces(printable(text))) == ([("", printable(text))] if text else [])


def test_every_mark_is_a_style_of_every_theme() -> None:
    marks = {getattr(INK, each.name) for each in fields(INK)}
    assert len(marks) == len(fields(INK))
    assert len(STYLE_NAMES) == len(marks) - 1 + 2
    assert all(getattr(PLAIN, each.name) == "" for each in fields(PLAIN))
    for theme in THEMES:
        assert set(theme_styles(theme)) == set(STYLE_NAMES.values())
