"""``bcapscope calls``: requests with their retries and replies, and what became of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from itertools import chain, starmap

import click

from bcapscope.cli import options
from bcapscope.cli.output import narrate, palette
from bcapscope.cli.pairing import settle
from bcapscope.cli.reading import Reading
from bcapscope.protocol.wording import counted
from bcapscope.render.call import CallRenderer, session_text
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.render.moment import Clock
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS
from bcapscope.traffic.handles import Handles, Thing

_MOST_SESSIONS_TOLD = 8


@click.command(short_help="Pair requests, retries and replies: a line a call.")
@options.paths
@options.interface
@options.ports
@click.option("--tree", is_flag=True, help="Each call's frames under it, with the times between.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a call.")
@options.filter_option(RecordKind.CALL)
@options.clock
@options.color
def command(
    *,
    paths: tuple[str, ...],
    interface: str | None,
    ports: tuple[int, ...],
    tree: bool,
    as_json: bool,
    wanted: Filter | None,
    clock: str,
    color: str,
) -> None:
    """Pair the frames of captures to calls.

    A line has: number, start, client > server, function and command, result, time to the accepted reply,
    retries and what they came from as far as the capture can tell, frame numbers of requests > replies.
    Calls come when they settle; the number tells the order in which they started.

    Exit codes: as of decode.
    """
    if tree and as_json:
        raise click.UsageError("--tree and --json exclude each other")
    reading = Reading(paths, ports, interface)
    calls = _Calls(settle(reading), wanted)
    if as_json:
        lines: Iterable[str] | Iterable[bytes] = starmap(CallRecordRenderer().record, calls.exchanges())
    else:
        renderer = CallRenderer(Clock(clock), palette(color))
        reading.begin = renderer.begin
        lines = starmap(renderer.line, calls.all())
        if tree:
            lines = chain.from_iterable(starmap(renderer.tree, calls.all()))
    reading.output.write_lines(lines, reading.pause)
    reading.summary()
    calls.summary()
    sys.exit(reading.exit)


class _Calls:
    """What settled, with the objects that handles stand for, and what is to be said at the end."""

    def __init__(self, settled: Iterable[Settled], wanted: Filter | None) -> None:
        self._settled = settled
        self._wanted = None if wanted is None else wanted.bind(CALL_GETTERS)
        self._handles = Handles()
        self._strays = 0
        self._first_stray = 0

    def all(self) -> Iterator[tuple[Settled, Thing | None]]:
        """Yield the calls that are wanted, and what belongs to no call unless something else is wanted."""
        wanted = self._wanted
        for item in self._settled:
            if isinstance(item, Exchange):
                subject = self._handles.follow(item)
                if wanted is None or wanted(item):
                    yield item, subject
            else:
                self._strays += 1
                self._first_stray = self._first_stray or item.seen.number
                if wanted is None:
                    yield item, None

    def exchanges(self) -> Iterator[tuple[Exchange, Thing | None]]:
        """Yield the calls that are wanted; for what belongs to none, JSON has no place."""
        for item, subject in self.all():
            if isinstance(item, Exchange):
                yield item, subject

    def summary(self) -> None:
        """Tell on stderr what belongs to no call, and which sessions left something behind."""
        if self._strays:
            count = counted(self._strays, "reply", "replies")
            narrate(f"{count} to no open call, the first in frame {self._first_stray}")
        unclean = [session for session in self._handles.sessions() if not session.is_clean]
        for session in unclean[:_MOST_SESSIONS_TOLD]:
            narrate(session_text(session))
        if len(unclean) > _MOST_SESSIONS_TOLD:
            narrate(f"… and {len(unclean) - _MOST_SESSIONS_TOLD} more sessions that were not ended in order")
