"""Marks of ink in rendered lines, for tests that compare only the text."""

from __future__ import annotations

from bcapscope.tui.ink import styled_pieces


def strip_styles(text: str) -> str:
    """Return a rendered line without its marks."""
    return "".join(piece for _, piece in styled_pieces(text))
