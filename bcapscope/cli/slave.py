"""``bcapscope slave``: show slave-mode sessions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import click

from bcapscope.analysis.slave.selected_sessions import SelectedSlaveSessions
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.figure_command import FigureArguments, figure_options
from bcapscope.live.standard_streams import print_stderr
from bcapscope.render.json_values import with_packets
from bcapscope.render.slave_session_record import slave_session_record
from bcapscope.render.slave_session_text import slave_session_lines


@click.command()
@figure_options("Print one JSON object per session.")
def command(**given: Any) -> None:
    """Show each slave-mode session: its client, how it ended, its timing and its motion.

    The cycle time is the time from the first attempt of one set point to the first attempt of the next.
    Jitter is the difference between a cycle time and the period. The line "grid" shows the period. If the
    period is 8 ms, a cycle time of 10 ms has a jitter of 2 ms. Latency is the time from the first attempt of
    a call to its accepted reply. The round trip starts at the attempt that was answered, and ends at the
    accepted reply.

    The controller's buffer cannot be observed. `slave` uses a model to estimate how full the buffer is, and
    lists the model's assumptions.

    --filter selects set points. The calls that begin and end a slave-mode session are always included.

    Exit codes: as for `decode`.
    """
    arguments = FigureArguments(**given)
    if arguments.as_json:
        arguments.reader.remember_origins()
    sessions = _warn_if_none(_read_slave_sessions(arguments), arguments)
    origin_of = arguments.reader.origin_of_frame
    arguments.print_all(
        sessions, lambda session: with_packets(slave_session_record(session), origin_of), slave_session_lines
    )


def _read_slave_sessions(arguments: FigureArguments) -> Iterator[SlaveSession]:
    sessions: list[SlaveSession] = []
    is_selected = arguments.reader.call_test(arguments.call_filter)
    selected = SelectedSlaveSessions(is_selected, sessions.append, arguments.window)
    pipeline = arguments.reader.pipeline(selected)
    yield from arguments.reader.read_items(pipeline, sessions)
    yield from selected.remaining_sessions(arguments.reader.ended_at)


def _warn_if_none(
    slave_sessions: Iterable[SlaveSession], arguments: FigureArguments
) -> Iterator[SlaveSession]:
    none = True
    for session in slave_sessions:
        none = False
        yield session
    if none and arguments.reader.exit_code is not ExitCode.UNREADABLE:
        print_stderr(
            "no slave-mode session found"
            if arguments.call_filter is None
            else "no set point matches the filter"
        )
