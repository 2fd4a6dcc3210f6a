"""Where output goes: data to stdout in large pieces, narration to stderr, colours where they are wanted."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from typing import TypeVar

import click

from bcapscope.render.palette import ANSI, PLAIN, Palette

_LINES_AT_ONCE = 512

_Seen = TypeVar("_Seen")


class Output:
    """Collects lines and writes many at once; `flush` is called before anything waits for more input."""

    def __init__(self) -> None:
        self._lines: list[bytes] = []
        self._stdout = sys.stdout.buffer

    def write_all(self, seen: Iterable[_Seen], render: Callable[[_Seen], bytes], pause: Callable[[], None]) -> None:
        """Write what `render` makes of each item, a line each; call `pause` after every few hundred."""
        lines = self._lines
        for item in seen:
            lines.append(render(item))
            if len(lines) >= _LINES_AT_ONCE:
                self.flush()
                pause()
        self.flush()

    def flush(self) -> None:
        """Write out what was collected."""
        lines = self._lines
        if lines:
            text = b"\n".join(lines) + b"\n"
            lines.clear()
            self._stdout.write(text)
        self._stdout.flush()


def narrate(text: str) -> None:
    """Tell the user something that is not data."""
    click.echo(text, err=True)


def palette(color: str) -> Palette:
    """Choose colours: `always`, `never`, or `auto` for a terminal without NO_COLOR (no-color.org)."""
    if color == "auto":
        return ANSI if sys.stdout.isatty() and not os.environ.get("NO_COLOR") else PLAIN
    return ANSI if color == "always" else PLAIN
