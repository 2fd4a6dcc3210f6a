"""The guided connect: one step after the other, each with what was found or why it failed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

from bcapscope.client.target import Target
from bcapscope.errors import BcapError, ControllerError, ExchangeTimeout
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.variant import VT, Variant
from bcapscope.render.meaning import value_text
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.desk import Desk, handle_variant
from bcapscope.tui.desk.halt import ROBOT
from bcapscope.tui.desk.news import Identity, Step, StepNews
from bcapscope.tui.desk.record import Ending, Record, Who, cause
from bcapscope.tui.desk.recorder import WHO
from bcapscope.tui.words import say, told

ROBSLAVE = "RobSlave"
"""The program that RC7 needs for slave mode (DENSO Wave 2009, How to use the Slave mode)."""

_UNKNOWN_PROVIDER = (0x80070057, 0x80000201)
"""What a controller answers to the name of a provider that it does not have: E_INVALIDARG (RC8), and the CAO
engine's own code (orin_bcap C/include/bcap_common.h)."""


class FailedError(BcapError):
    """A step failed; it has been told which and why."""


async def connect(desk: Desk, target: Target, providers: Sequence[str], robot: str, option: str) -> bool:
    """Walk all steps, up to the first that fails.

    Args:
        desk: that connects.
        target: the controller.
        providers: to be tried one after the other.
        robot: name of the robot to open; empty to leave that for later.
        option: for opening it.

    Returns:
        Whether all succeeded. After a failure before the controller was connected to, the link is closed.
    """
    WHO.set(Who.SCREEN)
    try:
        await _step(desk, Step.LINK, lambda: _link(desk, target))
        await _step(desk, Step.SERVICE, lambda: _service(desk))
        await _step(desk, Step.CONTROLLER, lambda: _controller(desk, target, providers))
    except FailedError:
        await desk.disconnect()
        return False
    except asyncio.CancelledError:
        await desk.disconnect()
        raise
    desk.open_halt_line(robot or ROBOT)
    try:
        await _step(desk, Step.IDENTITY, lambda: identify(desk))
        if robot:
            await _step(desk, Step.ROBOT, lambda: _robot(desk, robot, option))
    except FailedError:
        return False
    return True


async def add_robot(desk: Desk, robot: str, option: str) -> Record:
    """Open a robot, choose it, learn its type, and have HALT ready for it; return the record of its opening.

    Raises:
        BcapError, OSError: as `Desk.call`.
    """
    WHO.set(Who.USER)
    opened = await desk.open(desk.controller, ObjectClass.ROBOT, robot, option)
    record = desk.last
    if opened is not None:
        desk.choose(opened)
        desk.tell(StepNews(Step.ROBOT, True, ", ".join(filter(None, (robot, await read_type(desk, opened))))))
        desk.open_halt_line(robot)
    return record


async def start_robslave(desk: Desk) -> Record:
    """Open the task RobSlave unless it is open, start it for one cycle; return the record of the last call.

    Raises:
        BcapError, OSError: as `Desk.call`.
    """
    found = [one for one in desk.status.open if one.kind is ObjectClass.TASK and one.label == ROBSLAVE]
    task = found[-1] if found else await desk.open(desk.controller, ObjectClass.TASK, ROBSLAVE, "")
    if task is None:
        return desk.last
    return await desk.invoke("Task_Start", handle_variant(task), Variant(VT.I4, 1), Variant(VT.BSTR, ""))


async def _step(desk: Desk, step: Step, walk: Callable[[], Awaitable[str]]) -> None:
    desk.tell(StepNews(step, None))
    try:
        text = await walk()
    except ExchangeTimeout as error:
        desk.tell(StepNews(step, False, desk.why()))
        raise FailedError from error
    except (BcapError, OSError) as error:
        desk.tell(StepNews(step, False, cause(error)))
        raise FailedError from error
    desk.tell(StepNews(step, True, text))


async def _link(desk: Desk, target: Target) -> str:
    await desk.open_link(target)
    return told(str(target))


async def _service(desk: Desk) -> str:
    await desk.reach.start()
    return "Service_Start"


async def _controller(desk: Desk, target: Target, providers: Sequence[str]) -> str:
    """Connect with the first provider that the controller has."""
    for provider in providers:
        tried = replace(target, provider=provider)
        try:
            await desk.reach.invoke("Controller_Connect", *tried.connect)
        except ControllerError as error:
            if error.hresult not in _UNKNOWN_PROVIDER or provider == providers[-1]:
                raise
            continue
        desk.show(target=tried)
        return provider or "Controller_Connect"
    raise FailedError("no provider to try")


async def _robot(desk: Desk, name: str, option: str) -> str:
    controller = desk.controller
    robot = await desk.open(controller, ObjectClass.ROBOT, name, option)
    if robot is None:
        raise FailedError(desk.why())
    desk.choose(robot)
    found = await read_type(desk, robot)
    return ", ".join(filter(None, (name, found)))


async def identify(desk: Desk) -> str:
    """Learn what the peer is: our simulator, or what it says of itself."""
    simulator = await desk.reach.meets_simulator()
    version = await _read(desk, desk.controller, "@VERSION")
    desk.arming.needed = not simulator
    desk.show(identity=Identity(simulator, version))
    kind = say("desk.simulator" if simulator else "desk.controller")
    return f"{kind}, {say('desk.version', version=version)}" if version else kind


async def read_type(desk: Desk, robot: Opened) -> str:
    """Read the robot's type, which is to be looked at before the first motion (DENSO Wave 2009)."""
    name = await _read(desk, robot, "@TYPE_NAME")
    number = await _read(desk, robot, "@TYPE")
    desk.show(identity=replace(desk.status.identity, type_name=name, type_number=number))
    return " ".join(filter(None, (name, f"(@TYPE {number})" if number else "")))


async def _read(desk: Desk, owner: Opened, name: str) -> str:
    """Read a variable once; "" where there is none."""
    variable = await desk.open(owner, ObjectClass.VARIABLE, name, "", who=Who.SCREEN)
    if variable is None:
        return ""
    handle = Variant(VT.I4, variable.handle)
    record = await desk.invoke("Variable_GetValue", handle, who=Who.SCREEN)
    await desk.invoke("Variable_Release", handle, who=Who.SCREEN)
    if record.ending is not Ending.ANSWERED or record.reply is None or not record.reply.arguments:
        return ""
    value = record.reply.arguments[0].variant
    return value.value if isinstance(value.value, str) else value_text(value.value, value.vt)
