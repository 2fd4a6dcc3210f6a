"""Functions for standard output and standard error: print messages, choose colours, handle closed streams."""

from __future__ import annotations

import os
import re
import sys
from typing import TextIO

from bcapscope.render.color_palette import ANSI, PLAIN, Palette

_ANSI_SEQUENCE = re.compile(r"\x1b\[[;?0-9]*[a-zA-Z]")


def print_stderr(text: str) -> None:
    """Write a line to stderr; without colours if stderr is no terminal. Write nothing if stderr is closed."""
    stream = sys.stderr
    if stream is None:
        return
    try:
        shown = text if stream.isatty() else _ANSI_SEQUENCE.sub("", text)
        stream.write(f"{shown}\n")
        stream.flush()
    except OSError:
        _redirect_to_null(stream)


def choose_palette(color: str) -> Palette:
    """`color` is `always`, `never` or `auto`. With `auto`, NO_COLOR switches colours off (no-color.org)."""
    if color == "auto":
        return ANSI if sys.stdout.isatty() and not os.environ.get("NO_COLOR") else PLAIN
    return ANSI if color == "always" else PLAIN


def can_poll_stdin() -> bool:
    """A background job cannot read from its terminal. On Windows, `select` accepts only sockets."""
    if sys.platform == "win32" or sys.stdin is None or sys.stdin.closed:
        return False
    try:
        return not os.isatty(0) or os.tcgetpgrp(0) == os.getpgrp()
    except OSError:
        return False


def discard_stdout() -> None:
    """Discard the output that stdout did not accept, because Python would try to write it again at exit."""
    _redirect_to_null(sys.stdout)


def discard_unwritable_output() -> None:
    """Flush stdout and stderr, and discard the output of a closed terminal. Otherwise, Python would try to
    write this output again at exit, and would exit with 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            _redirect_to_null(stream)


def _redirect_to_null(stream: TextIO) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
