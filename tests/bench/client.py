"""Our client library beside a bare loop on a socket, all in one run: round trips a second, µs it adds.

All of them ask `bcapscope sim -q` for the same, slvMove in a mode that answers at once.
Run from the project's root as ``python -m tests.bench.client``.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from functools import partial

from bcapscope.client import DEFAULT_RETRY_POLICIES, Blocking, Robot, Service, connect, over_tcp, over_udp
from tests.bench.simulator import set_points
from tests.bench.trips import (
    J_MODE_1,
    SIMULATOR_PORT,
    TRANSPORTS,
    Arm,
    Figures,
    Job,
    Line,
    main,
    points,
    server,
    simulator,
)

BARE, ASYNC, BLOCKING = "bare loop", "await robot.slv_move", "wait(robot.slv_move)"
OPENERS = {"udp": over_udp, "tcp": over_tcp}
PATIENT = DEFAULT_RETRY_POLICIES._replace(asynchronous=DEFAULT_RETRY_POLICIES.others)
"""The recommended 2 ms would make a slow moment of the machine a call without answer."""


def bare(transport: str, count: int) -> list[int]:
    """Time a bare loop."""
    with server(simulator("-q"), SIMULATOR_PORT) as port:
        line = Line(transport, port)
        arm = Arm(line)
        return line.trips(set_points(line, arm, count))


async def prepare(service: Service) -> tuple[Robot, object]:
    """Switch slave mode on; return the robot and where it stands."""
    controller = await service.connect("", "CaoProv.DENSO.VRC", "localhost")
    robot = await controller.get_robot("Arm")
    await robot.execute("TakeArm")
    await robot.execute("Motor", 1)
    joints = await robot.execute("CurJnt")
    await robot.slv_change_mode(J_MODE_1)
    return robot, joints


def awaited(transport: str, count: int) -> list[int]:
    """Time calls that are awaited."""

    async def run(port: int) -> list[int]:
        took = []
        async with connect(OPENERS[transport]("127.0.0.1", port), retry_policies=PATIENT) as service:
            robot, joints = await prepare(service)
            for point in points(joints, count):
                began = time.perf_counter_ns()
                await robot.slv_move(point)
                took.append(time.perf_counter_ns() - began)
        return took

    with server(simulator("-q"), SIMULATOR_PORT) as port:
        return asyncio.run(run(port))


def waited_for(transport: str, count: int) -> list[int]:
    """Time calls of the face without async."""
    took = []
    with server(simulator("-q"), SIMULATOR_PORT) as port, Blocking() as wait:
        service = wait.enter(connect(OPENERS[transport]("127.0.0.1", port), retry_policies=PATIENT))
        robot, joints = wait(prepare(service))
        for point in points(joints, count):
            began = time.perf_counter_ns()
            wait(robot.slv_move(point))
            took.append(time.perf_counter_ns() - began)
    return took


def jobs() -> Iterator[Job]:
    """Yield what to run."""
    for transport in TRANSPORTS:
        yield Job(BARE, transport, partial(bare, transport))
        yield Job(ASYNC, transport, partial(awaited, transport))
        yield Job(BLOCKING, transport, partial(waited_for, transport))


def told(figures: Figures) -> Iterator[str]:
    """Yield what the library adds."""
    for transport in TRANSPORTS:
        least = figures.get((BARE, transport))
        for name in (ASYNC, BLOCKING):
            found = figures.get((name, transport))
            if least and found:
                more = found.p50 - least.p50
                yield f"{name}, {transport}: {more:.0f} µs more than the bare loop at the median"


if __name__ == "__main__":
    main(__doc__, list(jobs()), told)
