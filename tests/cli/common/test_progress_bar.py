"""The bar for reading that takes long."""

from __future__ import annotations

import io
import re
import sys

import click
import pytest

from bcapscope.cli.common import progress_bar
from bcapscope.cli.common.progress_bar import ReadProgressBar

HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"


class Terminal(io.StringIO):
    """Remembers what is written to it."""

    def isatty(self) -> bool:
        return True


def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Make standard error a terminal and standard output none, for somebody without patience."""
    made = Terminal()
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    monkeypatch.setattr(progress_bar, "_SHOWN_AFTER", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    return made


def show(ending: type[BaseException] | None = None) -> None:
    """Show the bar in a command that ends in some way."""
    with click.Context(click.Command("any")):
        ReadProgressBar().show(250, 1000)
        if ending is not None:
            raise ending


def test_shows_how_much_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = terminal(monkeypatch)
    show()
    assert "0.2/1.0 kB" in re.sub(r"\x1b\[[0-9;]*m", "", seen.getvalue())


@pytest.mark.parametrize("ending", [KeyboardInterrupt, BrokenPipeError])
def test_the_cursor_comes_back_however_the_command_ends(
    monkeypatch: pytest.MonkeyPatch, ending: type[BaseException]
) -> None:
    seen = terminal(monkeypatch)
    with pytest.raises(ending):
        show(ending)
    assert seen.getvalue().rindex(SHOW_CURSOR) > seen.getvalue().rindex(HIDE_CURSOR)


def test_what_has_no_size_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = terminal(monkeypatch)
    ReadProgressBar().show(250, None)
    assert seen.getvalue() == ""
