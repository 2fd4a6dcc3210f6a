"""A progress bar on stderr for long reads."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_SHOWN_AFTER = 1.0
"""Seconds of reading before the progress bar appears."""


class ReadProgressBar:
    """Shows how much of a file was read, if stderr is a terminal and stdout is not."""

    def __init__(self) -> None:
        self._began_at = time.monotonic()
        self._is_wanted = sys.stderr.isatty() and not sys.stdout.isatty()
        self._bar: Bar | None = None

    def show(self, position: int, size: int | None) -> None:
        """Show that `position` of `size` bytes were read. The bar is removed when the command ends."""
        if not self._is_wanted or size is None or time.monotonic() - self._began_at < _SHOWN_AFTER:
            return
        if self._bar is None:
            self._bar = _make_bar()
            self._bar.start()
            # Remove the bar even after Ctrl-C or a closed pipe, so that the terminal shows its cursor again.
            click.get_current_context().call_on_close(self.remove)
            self._bar.add_task("reading")
        self._bar.update(self._bar.task_ids[0], completed=position, total=size)

    def remove(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def _make_bar() -> Bar:
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True)
