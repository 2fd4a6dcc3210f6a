"""Where output goes: data to stdout in large pieces, narration to stderr, colours where they are wanted."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from typing import TypeGuard, cast

import click

from bcapscope.render.palette import ANSI, PLAIN, Palette


class Output:
    """Collects lines of data and writes many at once.

    `flush` is called before anything waits for more input, so that live traffic is seen as it comes.
    """

    def __init__(self, lines_at_once: int = 512) -> None:
        """Write when `lines_at_once` have come together."""
        self._most = lines_at_once
        self._lines: list[str] | list[bytes] = []
        self._stdout = sys.stdout.buffer

    def write_lines(self, lines: Iterable[str] | Iterable[bytes], pause: Callable[[], None]) -> None:
        """Write each line; call `pause` whenever some were written."""
        kept = self._lines
        append = cast(Callable[[str | bytes], None], kept.append)
        for line in lines:
            append(line)
            if len(kept) >= self._most:
                self.flush()
                pause()
        self.flush()

    def flush(self) -> None:
        """Write out what was collected."""
        lines = self._lines
        if lines:
            text = b"\n".join(lines) if _are_bytes(lines) else _encoded(cast(list[str], lines))
            lines.clear()
            self._stdout.write(text + b"\n")
        self._stdout.flush()


def _encoded(lines: list[str]) -> bytes:
    return "\n".join(lines).encode("utf-8")


def _are_bytes(lines: list[str] | list[bytes]) -> TypeGuard[list[bytes]]:
    return isinstance(lines[0], bytes)


def narrate(text: str) -> None:
    """Tell the user something that is not data."""
    click.echo(text, err=True)


def palette(color: str) -> Palette:
    """Choose colours: `always`, `never`, or `auto` for a terminal without NO_COLOR (no-color.org)."""
    if color == "auto":
        return ANSI if sys.stdout.isatty() and not os.environ.get("NO_COLOR") else PLAIN
    return ANSI if color == "always" else PLAIN
