"""``bcapscope ping``: is a controller there, what is it, and is the way to it good enough."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

import click
import numpy as np
import orjson

from bcapscope.analysis.distribution import Distribution, Histogram
from bcapscope.analysis.fitness import Fitness, fitness
from bcapscope.cli import options
from bcapscope.cli.connection import Target, failures_told, target
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import echo
from bcapscope.cli.signals import run_in_order
from bcapscope.client.reach import Reach
from bcapscope.client.session import Session, open_target
from bcapscope.client.target import reason_of
from bcapscope.errors import ControllerError
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.requester import TimedOut
from bcapscope.protocol.variant import VT, Variant
from bcapscope.render.escape import printable

_GET_ATTRIBUTE = 19
_ASKED = (
    ("version", ObjectClass.CONTROLLER, "@VERSION"),
    ("robot type", ObjectClass.ROBOT, "@TYPE_NAME"),
    ("robot type number", ObjectClass.ROBOT, "@TYPE"),
)


@dataclass(slots=True)
class _Found:
    """What came out.

    Attributes:
        there: somebody answered.
        simulator: it is our own.
        facts: what the controller says of itself.
        refused: why it would not be connected to; None where it was.
        broken: why not all calls could be made; None where they could.
        round_trips: ms.
        lost: calls without an answer.
    """

    there: bool = False
    simulator: bool = False
    facts: dict[str, object] = field(default_factory=dict)
    refused: str | None = None
    broken: str | None = None
    round_trips: list[float] = field(default_factory=list)
    lost: int = 0


@click.command(short_help="Is a controller there, what is it, how fast does it answer?")
@target
@click.option(
    "-n",
    "--count",
    type=options.Whole(1, options.LARGEST_COUNT),
    default=250,
    show_default=True,
    help="Calls.",
)
@click.option(
    "--interval",
    metavar="MS",
    type=options.Number(0),
    default=8.0,
    show_default=True,
    help="From one call to the next.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def command(*, target: Target, count: int, interval: float, as_json: bool) -> None:
    """Connect, ask what is there, and measure calls that only read; none is sent twice.

    The verdict is for set points each 8 ms (Sync) and each 1 ms (Async): nearly all answers within that
    time, and no more losses than retries make good.

    Ctrl-C ends it before all calls are made; what was found until then is shown.

    Exit codes: 0 calls were answered; 2 invalid command line; 9 no answer, or the connection
    broke; 130 it was ended.
    """
    found = _Found()
    code = Exit.UNANSWERED
    with failures_told(target):
        try:
            run_in_order(_ping(target, count, interval / 1000, found))
            code = Exit.OK if found.round_trips and found.broken is None else Exit.UNANSWERED
        except KeyboardInterrupt:
            code = Exit.INTERRUPTED
    if as_json:
        echo(orjson.dumps(_record(target, found)))
    else:
        for line in _lines(target, found):
            echo(line)
    sys.exit(code)


async def _ping(target: Target, count: int, interval: float, found: _Found) -> None:
    async with open_target(target) as session:
        reach = Reach(session, target.service, target.connect, {})
        await reach.start()
        found.there = True
        handle = 0
        try:
            handle = await reach.handle(ObjectClass.CONTROLLER)
            found.simulator = await reach.meets_simulator()
            await _ask(reach, found)
        except ControllerError as error:
            found.refused = str(error)
        try:
            await _measure(session, handle, count, interval, found)
        except ConnectionError as error:
            found.broken = reason_of(error)


async def _ask(reach: Reach, found: _Found) -> None:
    """Read what the controller says of itself, as far as it has such variables."""
    for name, owner, variable in _ASKED:
        try:
            parent = await reach.handle(owner)
            opened = await reach.invoke(f"{owner}_GetVariable", parent, variable, "")
            value = await reach.invoke("Variable_GetValue", opened)
            if value is not None:  # EMPTY says nothing
                found.facts[name] = value
            await reach.invoke("Variable_Release", opened)
        except ControllerError:
            continue


async def _measure(session: Session, handle: int, count: int, interval: float, found: _Found) -> None:
    usual = session.paces
    session.paces = usual._replace(others=usual.others._replace(retries=0))
    loop = asyncio.get_running_loop()
    due = loop.time()
    try:
        for _ in range(count):
            await asyncio.sleep(due - loop.time())
            settled = await session.exchange(_GET_ATTRIBUTE, (Variant(VT.I4, handle),))
            due = max(due + interval, loop.time())  # after a long wait the next ones do not hurry
            if isinstance(settled, TimedOut):
                found.lost += 1
            else:
                found.round_trips.append(settled.took / 1e6)
    finally:
        session.paces = usual


def _lines(target: Target, found: _Found) -> Iterator[str]:
    spread = _spread(found)
    if not found.there:
        yield f"{target}: nothing was answered"
        return
    kind = "bcapscope's simulator" if found.simulator else "a controller"
    facts = "".join(f", {name} {printable(str(value))}" for name, value in found.facts.items())
    yield f"{target}: {kind}{facts}"
    if found.refused is not None:
        yield f"not connected to: {printable(found.refused)}"
    yield f"{len(found.round_trips) + found.lost} calls, {found.lost} lost"
    if found.broken is not None:
        yield f"ended before all calls were made: {printable(found.broken)}"
    if spread is not None:
        yield (
            f"round trip, ms: p50 {spread.p50:.3f}, p90 {spread.p90:.3f}, p99 {spread.p99:.3f}, "
            f"p99.9 {spread.p999:.3f}, most {spread.most:.3f}"
        )
    for verdict in _verdicts(found):
        word = "fit" if verdict.fit else "not fit"
        yield f"{word} for set points each {verdict.period:g} ms: {verdict.reason}"


def _record(target: Target, found: _Found) -> dict[str, object]:
    spread = _spread(found)
    names = ("count", "mean", "least", "p50", "p90", "p99", "p999", "most")
    return {
        "host": target.host,
        "port": target.port,
        "transport": "tcp" if target.tcp else "udp",
        "simulator": found.simulator,
        "refused": found.refused,
        "broken": found.broken,
        "facts": {name: str(value) for name, value in found.facts.items()},
        "calls": len(found.round_trips) + found.lost,
        "lost": found.lost,
        "round_trip_ms": None if spread is None else {name: getattr(spread, name) for name in names},
        "fit": {f"{verdict.period:g} ms": verdict.fit for verdict in _verdicts(found)},
    }


def _verdicts(found: _Found) -> tuple[Fitness, ...]:
    return fitness(_spread(found), found.lost, found.broken is not None)


def _spread(found: _Found) -> Distribution | None:
    histogram = Histogram()
    histogram.add(np.array(found.round_trips))
    return histogram.distribution()
