"""Exit codes, the same for all commands."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import NoReturn

import click

from bcapscope.live.standard_streams import print_stderr


class ExitCode(IntEnum):
    OK = 0
    FINDINGS = 1
    """`diagnose --fail-on` found a problem of this severity or worse."""
    USAGE = 2
    """Invalid command line; nothing was read."""
    DAMAGED = 3
    """A capture is damaged or incomplete; everything before the damage was printed."""
    UNREADABLE = 4
    """The input could not be read: missing file, not a capture, or no permission to capture or listen."""
    NO_DATA = 5
    """The captures were read, but contain nothing that the command can write or play."""
    UNWRITABLE = 6
    """A file was not written, or is incomplete: it exists already, the disk is full, or access is denied."""
    NOT_INSTALLED = 7
    """An optional library that the command or an option needs is not installed."""
    REFUSED = 8
    """The controller refused a call."""
    UNANSWERED = 9
    """The controller cannot be reached, or did not answer in time."""
    UNARMED = 10
    """A call that can move the robot was not sent, because `--arm` or a confirmation is missing."""
    UNFIT = 11
    """The trajectory failed the pre-flight check; nothing moved."""
    INTERRUPTED = 130
    """Ctrl-C ended the command early; shells use this code for a program that SIGINT ended."""


def exit_with(text: str, code: int) -> NoReturn:
    print_stderr(text)
    sys.exit(code)


@contextmanager
def usage_error_on(kind: type[Exception]) -> Iterator[None]:
    try:
        yield
    except kind as error:
        raise click.UsageError(str(error)) from None


@contextmanager
def exit_on(kind: type[Exception], code: int) -> Iterator[None]:
    try:
        yield
    except kind as error:
        exit_with(str(error), code)
