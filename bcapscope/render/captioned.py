"""Lines that begin with a caption, and those that go on below it; in any tongue."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import Palette
from bcapscope.render.columns import wrap_text as broken
from bcapscope.render.tongue import Tongue, english

CAPTION_WIDTH = 12
TEXT_WIDTH = 62
"""Columns for what stands behind a caption, where it can be broken: with a scroll bar all fits into 80."""

_FRAMES_SHOWN = 8


def captioned_line(caption: str, text: str, palette: Palette, tongue: Tongue = english) -> str:
    caption = tongue(caption)
    space = " " * (CAPTION_WIDTH - display_width(caption))
    return f"  {palette.dim}{caption}{space}{palette.reset}{tongue(text)}".rstrip()


def continued_line(text: str, tongue: Tongue = english) -> str:
    """Write a line that belongs to the caption above."""
    return f"  {'':<{CAPTION_WIDTH}}{tongue(text)}"


def wrapped_lines(text: str, color: str = "", reset: str = "", tongue: Tongue = english) -> Iterator[str]:
    """Write a text of any length below a caption, in lines that fit; `color` begins and `reset` ends each."""
    return (continued_line(f"{color}{line}{reset}") for line in broken(tongue(text), TEXT_WIDTH))


def frames_text(frames: Sequence[int], count: int | None = None) -> str:
    """Name frames; of `count` in all, tell how many more there are."""
    shown = ", ".join(map(str, frames[:_FRAMES_SHOWN]))
    left = (len(frames) if count is None else count) - min(len(frames), _FRAMES_SHOWN)
    noun = "frame" if len(frames) == 1 and not left else "frames"
    return f"{noun} {shown}" + (f" and {left} more" if left else "") if frames else ""


def times_text(count: int) -> str:
    """Say how often: once, 2 times."""
    return "once" if count == 1 else f"{count} times"
