"""Write data to standard output in large blocks."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from typing import TypeGuard, cast

import click

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.standard_streams import discard_stdout
from bcapscope.messages.os_errors import os_reason
from bcapscope.render.columns import fold_line

_BATCH_CHARACTERS = 256 * 1024  # A batch of lines is written when it has this many characters.


class StdoutWriteError(click.ClickException):
    """Writing to standard output failed for a reason other than a closed pipe."""

    exit_code = ExitCode.UNWRITABLE

    def __init__(self, error: OSError) -> None:
        super().__init__(f"cannot write to standard output: {os_reason(error)}")


class DataOutput:
    def __init__(self, lines_at_once: int = 512) -> None:
        """Write `lines_at_once` lines at a time: many lines for speed, one line for live output."""
        self._lines_at_once = lines_at_once
        self._stdout = sys.stdout.buffer

    def write_lines(self, lines: Iterable[str] | Iterable[bytes], after_batch: Callable[[], None]) -> None:
        """Write the lines in batches, and call `after_batch` after each batch.

        Raises:
            BrokenPipeError: the reader closed stdout.
            StdoutWriteError: writing failed for another reason, such as a full disk.
        """
        batch: list[str | bytes] = []
        size = 0
        for line in cast("Iterable[str | bytes]", lines):
            batch.append(line)
            size += len(line)
            if size >= _BATCH_CHARACTERS or len(batch) >= self._lines_at_once:
                self._write(_joined_lines(batch))
                batch.clear()
                size = 0
                after_batch()
        if batch:
            self._write(_joined_lines(batch))
            after_batch()

    def _write(self, data: bytes) -> None:
        try:
            self._stdout.write(data)
            self._stdout.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            discard_stdout()
            raise StdoutWriteError(error) from None


def echo(text: str | bytes, end: bool = True) -> None:
    """Write a line to stdout without buffering. If `end` is False, the line gets no newline.

    Raises:
        BrokenPipeError: the reader closed stdout.
        StdoutWriteError: writing failed for another reason, such as a full disk.
    """
    try:
        click.echo(text, nl=end)
    except BrokenPipeError:
        raise
    except OSError as error:
        discard_stdout()
        raise StdoutWriteError(error) from None


def require_terminal() -> None:
    """Check that there is a terminal for the screen. A screen that is shown in a browser needs no terminal.

    Raises:
        UsageError: there is no terminal.
    """
    if "TEXTUAL_DRIVER" in os.environ:
        return
    if not all(stream is not None and stream.isatty() for stream in (sys.__stdin__, sys.__stderr__)):
        raise click.UsageError(
            "the screen needs a terminal. Without a terminal, use decode, calls or diagnose"
        )


def line_width(wide: bool) -> int | None:
    """Return the width of the terminal in columns. Return None if stdout is not a terminal, or if `wide` is
    True because lines must not be cut.
    """
    if wide or not sys.stdout.isatty():
        return None
    import shutil  # imported here because it loads compression libraries, which takes 10 ms

    return shutil.get_terminal_size().columns


def folded_lines(lines: Iterable[str], wide: bool) -> Iterable[str]:
    """Return the lines, folded at the width of the terminal. Without a terminal, or if `wide` is True, lines
    stay unchanged.
    """
    width = line_width(wide)
    return lines if width is None else (fold_line(line, width) for line in lines)


def _joined_lines(lines: list[str | bytes]) -> bytes:
    if _are_bytes(lines):
        return b"\n".join(lines) + b"\n"
    return ("\n".join(cast(list[str], lines)) + "\n").encode("utf-8")


def _are_bytes(lines: list[str | bytes]) -> TypeGuard[list[bytes]]:
    return isinstance(lines[0], bytes)
