"""Write data to standard output in large blocks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.standard_streams import discard_stdout
from bcapscope.messages.os_errors import os_reason
from bcapscope.render.columns import fold_line

LINES_AT_ONCE = 512
"""Maximum number of lines per batch. Live output is written line by line."""

_BATCH_CHARACTERS = 256 * 1024  # A batch of lines is written when it has this many characters.


class OutputError(click.ClickException):
    """A file or stdout cannot be written. The message contains no control characters."""

    exit_code = ExitCode.UNWRITABLE


def discarded_stdout(error: OSError) -> OutputError:
    """Discard all further output to stdout. Return the exception to raise."""
    discard_stdout()
    return OutputError(f"cannot write to standard output: {os_reason(error)}")


@contextmanager
def _write_errors_reported() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise discarded_stdout(error) from None


def write_lines(
    lines: Iterable[str] | Iterable[bytes],
    lines_at_once: int = LINES_AT_ONCE,
    after_batch: Callable[[], None] = lambda: None,
) -> None:
    """Write the lines in batches, and call `after_batch` after each batch. Raises BrokenPipeError if the
    reader closed stdout, and OutputError for other reasons, such as a full disk.
    """
    batch: list[str | bytes] = []
    size = 0
    for line in lines:
        batch.append(line)
        size += len(line)
        if size >= _BATCH_CHARACTERS or len(batch) >= lines_at_once:
            _write_batch(batch)
            batch.clear()
            size = 0
            after_batch()
    if batch:
        _write_batch(batch)
        after_batch()


def _write_batch(lines: list[Any]) -> None:
    is_binary = isinstance(lines[0], bytes)
    data = b"\n".join(lines) + b"\n" if is_binary else ("\n".join(lines) + "\n").encode()
    with _write_errors_reported():
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()


def echo(text: str | bytes, end: bool = True) -> None:
    """Write a line to stdout without buffering. Raises the same exceptions as `write_lines`."""
    with _write_errors_reported():
        click.echo(text, nl=end)


def line_width(wide: bool) -> int | None:
    """Return the width of the terminal in columns; None if stdout is no terminal or `wide` is True."""
    if wide or not sys.stdout.isatty():
        return None
    import shutil  # imported late: `shutil` loads compression libraries, which takes 10 ms

    return shutil.get_terminal_size().columns


def folded_lines(lines: Iterable[str], wide: bool) -> Iterable[str]:
    """Fold the lines at the width of the terminal if stdout is a terminal and `wide` is False."""
    width = line_width(wide)
    return lines if width is None else (fold_line(line, width) for line in lines)
