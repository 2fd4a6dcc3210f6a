"""``bcapscope calls``: requests with their retries and replies, and what became of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

import click

from bcapscope.cli import options
from bcapscope.cli.output import narrate, palette
from bcapscope.cli.reading import Reading
from bcapscope.render.call import CallRenderer, counted
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.render.moment import Clock
from bcapscope.traffic.exchange import Exchange, Settled, Stray
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker


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
    strays = _Strays()
    settled = settle(reading.observations())
    calls = strays.apart(settled, wanted)
    if as_json:
        reading.output.write_lines(map(CallRecordRenderer().record, calls), reading.pause)
    else:
        renderer = CallRenderer(Clock(clock), palette(color))
        shown = settled if wanted is None else calls
        lines = (
            (line for call in shown for line in renderer.tree(call)) if tree else map(renderer.line, shown)
        )
        reading.output.write_lines(lines, reading.pause)
    reading.summary()
    strays.summary()
    sys.exit(reading.exit)


def settle(observations: Iterable[Observation]) -> Iterator[Settled]:
    """Yield calls as they settle, and what belongs to none."""
    tracker = Tracker()
    observe = tracker.observe
    for observation in observations:
        yield from observe(observation)
    yield from tracker.close()


class _Strays:
    """Counts what belongs to no call, since JSON has no place for it."""

    def __init__(self) -> None:
        self._count = 0
        self._first = 0

    def apart(self, settled: Iterable[Settled], wanted: Filter | None) -> Iterator[Exchange]:
        test = None if wanted is None else wanted.bind(CALL_GETTERS)
        for item in settled:
            if isinstance(item, Stray):
                self._count += 1
                self._first = self._first or item.seen.number
            elif test is None or test(item):
                yield item

    def summary(self) -> None:
        if self._count:
            count = counted(self._count, "reply", "replies")
            narrate(f"{count} to no open call, the first in frame {self._first}")
