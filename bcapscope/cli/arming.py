"""Asking whether a robot may be energised and moved, and logging the calls that follow."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from bcapscope.cli.output import narrate
from bcapscope.client.action_log import ActionLog, LoggedConnection, default_folder
from bcapscope.client.armed_calls import ArmedCalls
from bcapscope.client.target import reason_of
from bcapscope.render.escape import printable


@contextmanager
def armed_calls(program: str, connection: LoggedConnection) -> Iterator[ArmedCalls]:
    """Log the armed calls of a connection; a log that cannot be written is reported and ends nothing."""
    log = ActionLog(default_folder(), program, _report)
    calls = ArmedCalls(log, connection)
    try:
        yield calls
    finally:
        calls.end_set_points()
        log.close()


def _report(path: Path, error: OSError) -> None:
    reason = reason_of(error)
    narrate(printable(f"bcapscope: cannot write the action log {path}: {reason}. Calls are sent without it."))


def can_ask() -> bool:
    """Tell whether there is somebody to ask: both ends are a terminal."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def unarmed(host: str) -> str:
    """Return why a call that needs arming was not sent to `host`, and what to do."""
    return (
        f"It may move a robot or energise it, and {host} is not bcapscope's simulator. "
        "Add --arm if the robot may move."
    )


def confirmed(host: str) -> bool:
    """Let the user type the controller's address, which nobody does by accident.

    Raises:
        click.Abort: by Ctrl-C, or the end of what is typed.
    """
    typed: str = click.prompt(f"Type {printable(host)} if it may", default="", show_default=False, err=True)
    return typed.strip() == host
