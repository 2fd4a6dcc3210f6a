"""Ask the user to confirm that a robot may move, and log the armed calls."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from bcapscope.client.action_log import ActionLog, ArmedCallLogger, LoggedConnection, default_folder
from bcapscope.live.standard_streams import print_stderr
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.os_errors import os_reason
from bcapscope.render.escape import printable


@contextmanager
def log_armed_calls(program: str, connection: LoggedConnection) -> Iterator[ArmedCallLogger]:
    """Write the armed calls of a connection to the action log. If writing fails, warn and continue."""
    log = ActionLog(default_folder(), program, _warn_log_unwritable)
    calls = ArmedCallLogger(log, connection)
    try:
        yield calls
    finally:
        calls.end_set_points()
        log.close()


def _warn_log_unwritable(path: Path, error: OSError) -> None:
    reason = os_reason(error)
    print_stderr(
        printable(
            f"bcapscope: cannot write the action log {path}: {reason}. Calls are sent without a log entry."
        )
    )


def can_prompt() -> bool:
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def unarmed_reason(host: str) -> Message:
    return Message("arm.missing", host=host)


def confirm_robot_may_move(host: str, words: MessageFormatter) -> bool:
    """Return whether the user types the controller's address. Raises click.Abort if stdin ended."""
    return prompt_line(words("arm.confirm", host=printable(host))) == host


def prompt_line(question: str) -> str:
    """Write a question to stderr, and return the typed line. Raise click.Abort if standard input ended.

    `click.prompt` calls Python's `input`, which loses a Ctrl-C while it prints the question.
    """
    sys.stderr.write(f"{question}: ")
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise click.Abort
    return line.strip()
