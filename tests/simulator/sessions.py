"""What clients do that meet a scenario: sessions in which nothing is wrong, written with the client library.

They are as stubborn as many programs are: what is refused or not answered is not done, and the next thing is
tried.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from math import cos, pi
from typing import Any, TypeAlias

from bcapscope.client import connect
from bcapscope.client.remote_objects import Controller, Robot, Service
from bcapscope.client.session import LinkOpener
from bcapscope.errors import CallTimeout, ControllerError
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import Generation, slave_mode_by_number
from bcapscope.simulator.profile import Profile
from bcapscope.simulator.scenario import ClientProgram, ScenarioClient

FIRST = (5.0, 0.0, 90.0, 0.0, 90.0, 0.0)
POINTS = 150
PERIOD = 0.008
GIVES_UP_AFTER = 3
"""Set points refused one after the other."""

Reach: TypeAlias = Callable[[str], LinkOpener]
"""Gives the way to the controller for a client of a name."""


async def play(client: ScenarioClient, profile: Profile, reach: Reach) -> None:
    """Be the client of a scenario."""

    async def act(service: Service) -> None:
        if client.session is ClientProgram.CALLS:
            await _calls(service, profile)
        elif client.session is ClientProgram.MOTION:
            await _motion(service, profile)
        else:
            await _slave(service, client, profile)

    first = _with_service(reach("first"), client.options, act)
    if client.session is ClientProgram.GRIPPER:
        await asyncio.gather(first, _with_service(reach("second"), client.options, _grip))
    else:
        await first


async def _with_service(opener: LinkOpener, options: str, act: Callable[[Service], Awaitable[None]]) -> None:
    """Start a service session, act in it, and end it; a controller that is not there ends all."""
    try:
        async with connect(opener, options) as service:
            await act(service)
    except (ControllerError, CallTimeout, ConnectionError):
        pass


async def _try(step: Awaitable[Any]) -> Any:
    """Do something; None where it is refused or not answered."""
    try:
        return await step
    except (ControllerError, CallTimeout):
        return None


async def _open(service: Service, profile: Profile) -> tuple[Controller, Robot]:
    provider = "CaoProv.DENSO.VRC9" if profile.name == "rc9" else "CaoProv.DENSO.VRC"
    controller = await service.connect("", provider, "localhost")
    robot = await controller.get_robot("Arm")
    async with await robot.get_variable("@TYPE") as kind:
        await kind.get_value()
    return controller, robot


async def _calls(service: Service, profile: Profile) -> None:
    controller, robot = await _open(service, profile)
    async with await controller.get_variable("I1") as variable:
        for number in range(20):
            await _try(variable.put_value(number))
            await _try(variable.get_value())
            await _try(robot.execute("CurJnt"))
            await asyncio.sleep(0.05)


async def _ready(controller: Controller, robot: Robot, profile: Profile) -> None:
    if profile.needs_arm:
        await _try(robot.execute("TakeArm", [0, 0]))
    if profile.needs_robslave:
        task = await _try(controller.get_task("RobSlave"))
        if task is not None:
            await _try(task.start(1))
    await _try(robot.execute("Motor", [1, 0]))


async def _motion(service: Service, profile: Profile) -> None:
    controller, robot = await _open(service, profile)
    await _ready(controller, robot, profile)
    for first in (20, -20, 0):
        await _try(robot.move(1, f"@E J({first},0,90,0,90,0)"))
    await _done(robot, profile)


async def _slave(service: Service, client: ScenarioClient, profile: Profile) -> None:
    controller, robot = await _open(service, profile)
    await _ready(controller, robot, profile)
    passing = "@P" if client.session is ClientProgram.PASSING else "@E"
    await _try(robot.move(1, f"{passing} J({','.join(map(str, FIRST))})"))
    if profile.generation is Generation.RC8:
        await _try(robot.execute("slvSendFormat", 0))
        await _try(robot.execute("slvRecvFormat", 2))
    await _try(robot.slv_change_mode(client.mode))
    if not await _stream(robot, client, profile):
        await _try(robot.slv_change_mode(0))
        count = await _try(controller.execute("GetCurErrorCount"))
        for index in range(count or 0):
            await _try(controller.execute("GetCurErrorInfo", index))
        return
    await _try(robot.slv_change_mode(0))
    await _done(robot, profile)


async def _stream(robot: Robot, client: ScenarioClient, profile: Profile) -> bool:
    """Send the set points; return whether none of the last was refused."""
    mode = slave_mode_by_number(client.mode, profile.generation)
    assert mode is not None
    loop = asyncio.get_running_loop()
    began, refused = loop.time(), 0
    for number in range(POINTS):
        due = began + max(0, number - 1) * PERIOD  # two at once, as the first of them is taken at once
        if not mode.paces_client and due > loop.time():
            await asyncio.sleep(due - loop.time())
        try:
            await robot.slv_move(_point(number, profile))
            refused = 0
        except CallTimeout:
            continue
        except ControllerError:
            refused += 1
            if refused == GIVES_UP_AFTER:
                return False
    return True


def _point(number: int, profile: Profile) -> Variant:
    """Return a set point of a wave that begins and ends at rest."""
    angle = FIRST[0] + 5 * (1 - cos(2 * pi * number / (POINTS - 1)))
    values = (angle, *FIRST[1:], 0.0, 0.0)
    return Variant.array(VT.R8 if profile.real == VT.R8 else VT.R4, values)


async def _done(robot: Robot, profile: Profile) -> None:
    await _try(robot.execute("Motor", [0, 0]))
    if profile.needs_arm:
        await _try(robot.execute("GiveArm"))


async def _grip(service: Service) -> None:
    controller = await service.connect("", "CaoProv.DENSO.VRC", "localhost")
    async with await controller.get_variable("IO128") as output:
        for number in range(8):
            await asyncio.sleep(0.25)
            await _try(output.put_value(bool(number % 2)))
