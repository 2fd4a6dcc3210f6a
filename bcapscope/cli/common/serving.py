"""Error handling of commands that listen for clients."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.simulator.listening_sockets import SimulatorListenError


@contextmanager
def exit_if_not_listening() -> Iterator[None]:
    """Print why the server cannot listen, and exit with `ExitCode.UNREADABLE`."""
    try:
        yield
    except SimulatorListenError as error:
        exit_with(str(error), ExitCode.UNREADABLE)
