"""`bcapscope sim` beside a bare echo server, all in one run: round trips a second, percentiles, ratios.

The client is the same bare loop in all cases, and the echo server gets the bytes of slvMove.
Run from the project's root as ``python -m tests.bench.simulator``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

from bcapscope.protocol.codec.variant import EMPTY
from tests.bench.trips import (
    ECHO_PORT,
    EXECUTE,
    GET_VALUE,
    SIMULATOR_PORT,
    TRANSPORTS,
    Arm,
    Figures,
    Job,
    Line,
    bstr,
    echo,
    main,
    points,
    server,
    simulator,
)

ECHO = "bare echo of slvMove"
SET_POINT = "sim -q, slvMove"
LOGGED = "sim, slvMove"

Ask = Callable[[Line, Arm, int], list[bytes]]


def set_points(line: Line, arm: Arm, count: int) -> list[bytes]:
    """Make so many requests with set points."""
    name = bstr("slvMove")
    return [line.request(EXECUTE, arm.robot, name, point) for point in points(arm.joints, count)]


def joints(line: Line, arm: Arm, count: int) -> list[bytes]:
    """Make so many requests for the joints."""
    return [line.request(EXECUTE, arm.robot, bstr("CurJnt"), EMPTY) for _ in range(count)]


def value(line: Line, arm: Arm, count: int) -> list[bytes]:
    """Make so many requests for a variable."""
    return [line.request(GET_VALUE, arm.variable) for _ in range(count)]


ASKED: Mapping[str, tuple[Ask, tuple[str, ...]]] = {
    SET_POINT: (set_points, ("-q",)),
    "sim -q, CurJnt": (joints, ("-q",)),
    "sim -q, Variable_GetValue": (value, ("-q",)),
    LOGGED: (set_points, ()),
}


def simulated(transport: str, ask: Ask, options: tuple[str, ...], count: int) -> list[int]:
    """Time calls to the simulator."""
    with server(simulator(*options), SIMULATOR_PORT) as port:
        line = Line(transport, port)
        arm = Arm(line)
        return line.trips(ask(line, arm, count))


def echoed(transport: str, count: int) -> list[int]:
    """Time the same bytes to the echo server; the robot is asked for nothing."""
    with server(simulator("-q"), SIMULATOR_PORT) as port:
        arm = Arm(Line(transport, port))
    with server(echo(transport), ECHO_PORT) as port:
        line = Line(transport, port)
        return line.trips(set_points(line, arm, count), answered=False)


def jobs() -> Iterator[Job]:
    """Yield what to run."""
    for transport in TRANSPORTS:
        yield Job(ECHO, transport, partial(echoed, transport))
        for name, (ask, options) in ASKED.items():
            yield Job(name, transport, partial(simulated, transport, ask, options))


def told(figures: Figures) -> Iterator[str]:
    """Yield the share of the echo's rate."""
    for transport in TRANSPORTS:
        bare = figures.get((ECHO, transport))
        for name in ASKED:
            found = figures.get((name, transport))
            if bare and found:
                yield f"{name}, {transport}: {found.rate / bare.rate:.2f} of the echo's rate"


if __name__ == "__main__":
    main(__doc__, list(jobs()), told)
