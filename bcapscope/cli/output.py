"""Where output goes: data to stdout in large pieces, narration to stderr, colours where they are wanted."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from itertools import islice
from typing import TypeGuard, cast

import click

from bcapscope.render.palette import ANSI, PLAIN, Palette


class Output:
    """Writes lines of data to stdout."""

    def __init__(self, lines_at_once: int = 512) -> None:
        """Write so many lines at once: many for speed, one where they are to be seen as they come."""
        self._most = lines_at_once
        self._stdout = sys.stdout.buffer

    def write_lines(self, lines: Iterable[str] | Iterable[bytes], pause: Callable[[], None]) -> None:
        """Write each line; call `pause` whenever some were written."""
        source = iter(cast("Iterable[str | bytes]", lines))
        while batch := list(islice(source, self._most)):
            self._stdout.write(_joined(batch))
            self._stdout.flush()
            pause()


def _joined(lines: list[str | bytes]) -> bytes:
    if _are_bytes(lines):
        return b"\n".join(lines) + b"\n"
    return ("\n".join(cast(list[str], lines)) + "\n").encode("utf-8")


def _are_bytes(lines: list[str | bytes]) -> TypeGuard[list[bytes]]:
    return isinstance(lines[0], bytes)


def narrate(text: str) -> None:
    """Tell the user something that is not data."""
    click.echo(text, err=True)


def palette(color: str) -> Palette:
    """Choose colours: `always`, `never`, or `auto` for a terminal without NO_COLOR (no-color.org)."""
    if color == "auto":
        return ANSI if sys.stdout.isatty() and not os.environ.get("NO_COLOR") else PLAIN
    return ANSI if color == "always" else PLAIN
