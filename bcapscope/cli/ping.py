"""``bcapscope ping``: check that a controller answers, and that the network is fast enough."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

import click
import numpy as np
import orjson

from bcapscope.analysis.slave.fitness import Fitness, fitness
from bcapscope.analysis.statistics.distribution import Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.cli.common import options
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.cli.common.target_options import ControllerTarget, exit_on_failure, target_options
from bcapscope.client.object_opener import ObjectOpener, read_variable_once
from bcapscope.client.remote_objects import Controller, Robot
from bcapscope.client.session import Session, open_target_session
from bcapscope.errors import ControllerError
from bcapscope.live.end_signals import run_interruptible
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallTimedOut
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.render.escape import printable

_GET_ATTRIBUTE = 19
_VARIABLES = (
    ("version", Controller, "@VERSION"),
    ("robot type", Robot, "@TYPE_NAME"),
    ("robot type number", Robot, "@TYPE"),
)


@dataclass(slots=True)
class _PingResult:
    """Round trips are in ms. `break_reason` says why `ping` ended early."""

    is_answering: bool = False
    is_simulator: bool = False
    facts: dict[str, object] = field(default_factory=dict)
    refusal: Message | None = None
    break_reason: Message | None = None
    round_trips: list[float] = field(default_factory=list)
    lost: int = 0


@click.command()
@target_options
@click.option(
    "-n",
    "--count",
    type=options.IntegerRange(1, options.LARGEST_COUNT),
    default=250,
    show_default=True,
    help="Make this many calls.",
)
@click.option(
    "--interval",
    metavar="MS",
    type=options.NumberRange(0),
    default=8.0,
    show_default=True,
    help="Time in ms from one call to the next.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@options.language
def command(
    *, target: ControllerTarget, count: int, interval: float, as_json: bool, words: MessageFormatter
) -> None:
    """Check that a controller answers, identify the controller, and measure round trips.

    `ping` connects and makes calls that only read data from the controller. `ping` sends each call once,
    without retries. At the end, `ping` judges whether the network is fit for set points every 8 ms (Sync) and
    every 1 ms (Async). The network is fit if nearly all replies arrive within 8 ms (Sync) or 1 ms (Async),
    and retries make up for losses. If no program listens on the port, `ping` reports the closed port
    immediately.

    After Ctrl-C, `ping` prints the results so far and ends.

    Exit codes: 0: calls were answered; 2: invalid command line; 9: no answer, or the connection broke; 130:
    Ctrl-C.
    """
    found = _PingResult()
    code = ExitCode.UNANSWERED
    with exit_on_failure(target, words):
        try:
            run_interruptible(_ping(target, count, interval / 1000, found))
            code = ExitCode.OK if found.round_trips and found.break_reason is None else ExitCode.UNANSWERED
        except ConnectionRefusedError:
            exit_with(f"bcapscope: {words('ping.refused-port', target=words.text(target.message))}", code)
        except KeyboardInterrupt:
            code = ExitCode.INTERRUPTED
    if as_json:
        echo(orjson.dumps(_record(target, found)))
    else:
        for line in _lines(target, found, words):
            echo(line)
    sys.exit(code)


async def _ping(target: ControllerTarget, count: int, interval: float, found: _PingResult) -> None:
    async with open_target_session(target, fails_if_refused=True) as session:
        opener = ObjectOpener(session, target)
        await opener.start_service()
        found.is_answering = True
        handle = 0
        try:
            handle = await opener.handle_for(ObjectClass.CONTROLLER)
            found.is_simulator = await opener.is_simulator()
            await _read_facts(opener, found)
        except ControllerError as error:
            found.refusal = error.message
        try:
            await _measure(session, handle, count, interval, found)
        except ConnectionError as error:
            found.break_reason = os_reason(error)


async def _read_facts(opener: ObjectOpener, found: _PingResult) -> None:
    for name, owner, variable in _VARIABLES:
        try:
            value = await read_variable_once(await opener.open_remote(owner), variable)
        except ControllerError:
            continue
        # a value of type EMPTY means that the variable has no value
        if value is not None and value.value is not None:
            found.facts[name] = value.value


async def _measure(session: Session, handle: int, count: int, interval: float, found: _PingResult) -> None:
    usual = session.retry_policies
    session.retry_policies = usual._replace(others=usual.others._replace(retries=0))
    loop = asyncio.get_running_loop()
    due = loop.time()
    try:
        for _ in range(count):
            await asyncio.sleep(due - loop.time())
            settled = await session.perform_call(_GET_ATTRIBUTE, (Variant(VT.I4, handle),))
            # after a slow call, do not make up for missed intervals with a burst of calls
            due = max(due + interval, loop.time())
            if isinstance(settled, CallTimedOut):
                found.lost += 1
            else:
                found.round_trips.append(settled.elapsed / 1e6)
    finally:
        session.retry_policies = usual


def _lines(target: ControllerTarget, found: _PingResult, words: MessageFormatter) -> Iterator[str]:
    spread, name = _spread(found), words.text(target.message)
    if not found.is_answering:
        yield words("ping.no-answer", target=name)
        return
    facts = "".join(f", {fact} {printable(str(value))}" for fact, value in found.facts.items())
    yield words("ping.simulator" if found.is_simulator else "ping.controller", target=name) + facts
    if found.refusal is not None:
        yield printable(words("ping.refused", reason=found.refusal))
    yield words("ping.calls", calls=Count(len(found.round_trips) + found.lost, "call"), lost=found.lost)
    if found.break_reason is not None:
        yield printable(words("ping.ended-early", reason=found.break_reason))
    if spread is not None:
        levels = ("p50", "p90", "p99", "p999", "most")
        yield words("ping.round-trip", **{level: f"{getattr(spread, level):.3f}" for level in levels})
    for verdict in _verdicts(found):
        fit = "ping.fit" if verdict.fit else "ping.not-fit"
        yield words(fit, period=f"{verdict.period_ms:g}", reason=verdict.reason)


def _record(target: ControllerTarget, found: _PingResult) -> dict[str, object]:
    spread = _spread(found)
    names = ("count", "mean", "least", "p50", "p90", "p99", "p999", "most")
    return {
        "host": target.host,
        "port": target.port,
        "transport": "tcp" if target.tcp else "udp",
        "simulator": found.is_simulator,
        "refused": None if found.refusal is None else str(found.refusal),
        "broken": None if found.break_reason is None else str(found.break_reason),
        "facts": {name: str(value) for name, value in found.facts.items()},
        "calls": len(found.round_trips) + found.lost,
        "lost": found.lost,
        "round_trip_ms": None if spread is None else {name: getattr(spread, name) for name in names},
        "fit": {f"{verdict.period_ms:g} ms": verdict.fit for verdict in _verdicts(found)},
    }


def _verdicts(found: _PingResult) -> tuple[Fitness, ...]:
    return fitness(_spread(found), found.lost, found.break_reason is not None)


def _spread(found: _PingResult) -> DistributionSummary | None:
    histogram = Histogram()
    histogram.add(np.array(found.round_trips))
    return histogram.distribution()
