"""``bcapscope slave``: stays in slave mode."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

import click

from bcapscope.analysis.slave.session_detector import SelectedSlaveSessions
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.cli.common.call_reading import read_calls
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.figure_command import FigureArguments, figure_command
from bcapscope.live.standard_streams import print_stderr
from bcapscope.render.slave_session_record import slave_session_record
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.getters import CALL_GETTERS


@click.command(short_help="Slave mode: cycle times, retries, the controller's buffer, clock and motion.")
@figure_command("One JSON object a stay.")
def command(arguments: FigureArguments) -> None:
    """Tell about each stay in slave mode: who entered and how it ended, when set points were sent and
    answered, and what they command.

    The cycle is the time between the first requests of successive set points, jitter its distance from the
    grid. Latency runs from the first request to the accepted reply, the round trip from the request that it
    answers. What the controller's buffer held is predicted by a model, which tells what it takes for granted.

    A filter chooses set points; what begins and ends a stay is followed all the same.

    Exit codes: as of decode.
    """
    reading = arguments.reader
    stays = _warn_if_none(_read_slave_sessions(arguments), arguments)
    if arguments.as_json:
        reading.output.write_lines(map(slave_session_record, stays), reading.show_progress)
    else:
        lines = (line for stay in stays for line in (*slave_session_lines(stay, arguments.palette), ""))
        reading.output.write_lines(lines, reading.show_progress)
    reading.print_summary()
    sys.exit(reading.exit_code)


def _read_slave_sessions(arguments: FigureArguments) -> Iterator[SlaveSession]:
    watcher = SelectedSlaveSessions(
        None if arguments.call_filter is None else arguments.call_filter.bind(CALL_GETTERS), arguments.window
    )
    take = watcher.add_call
    for item in read_calls(arguments.reader):
        if isinstance(item, Call):
            ended = take(item)
            if ended:
                yield from ended
    yield from watcher.finish(arguments.reader.ended_at)


def _warn_if_none(
    slave_sessions: Iterable[SlaveSession], arguments: FigureArguments
) -> Iterator[SlaveSession]:
    """Pass stays on; tell if there is none in what was read."""
    none = True
    for stay in slave_sessions:
        none = False
        yield stay
    if none and arguments.reader.exit_code is not ExitCode.UNREADABLE:
        print_stderr(
            "no slave mode here" if arguments.call_filter is None else "no set point fits the filter"
        )
