"""Connects to a controller step by step, and reports the result of each step."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from bcapscope.client.controller_target import DEFAULT_ROBOT, ROBSLAVE, ControllerTarget
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.client.object_opener import read_variable_once
from bcapscope.client.remote_objects import ONE_CYCLE, Controller, Robot, Task
from bcapscope.errors import BcapError, CallTimeout, RemoteProtocolError
from bcapscope.live.controller.controller_session import ControllerSession
from bcapscope.live.controller.history_record import (
    HistoryRecord,
    Initiator,
    Reason,
    error_reason,
    failure_reason,
)
from bcapscope.live.controller.history_recorder import INITIATOR
from bcapscope.live.controller.session_updates import ConnectStep, ConnectStepUpdate, ControllerIdentity
from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import EMPTY
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.render.value_text import value_text


class ConnectStepError(BcapError):
    """A step of connecting failed. The screen has already received the reason for the failure."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(Message("controller.step-failed"))
        self.reason = reason


async def connect(
    session: ControllerSession, target: ControllerTarget, providers: Sequence[str], robot: str, option: str
) -> bool:
    """Run the steps of connecting until a step fails. Return whether all steps succeeded.

    Try the `providers` in the given order. If `robot` is "", open no robot. If `Controller_Connect` or an
    earlier step fails, the link is closed.
    """
    INITIATOR.set(Initiator.SCREEN)
    try:
        with _reported_step(session, ConnectStep.LINK) as result:
            await session.open_link(target)
            transport = "TCP" if target.tcp else "UDP"
            result.append(Message("controller.target", address=target.address, transport=transport))
        with _reported_step(session, ConnectStep.SERVICE) as result:
            await session.opener.start_service()
            result.append("Service_Start")
        with _reported_step(session, ConnectStep.CONTROLLER) as result:
            provider = await session.opener.connect_controller(providers)
            session.update_status(target=replace(target, provider=provider))
            result.append(provider or "Controller_Connect")
    except ConnectStepError:
        await session.disconnect()
        return False
    except asyncio.CancelledError:
        await session.disconnect()
        raise
    session.open_halt_connection(robot or DEFAULT_ROBOT)
    try:
        with _reported_step(session, ConnectStep.IDENTITY) as result:
            result.extend(await _identify_controller(session))
        if robot:
            with _reported_step(session, ConnectStep.ROBOT) as result:
                record, found = await _open_robot(session, robot, option)
                if found is None:
                    raise ConnectStepError(failure_reason(record))
                result.extend(found)
    except ConnectStepError:
        return False
    return True


async def add_robot(session: ControllerSession, robot: str, option: str) -> HistoryRecord:
    """Open and select a robot, read its type, and prepare HALT. Return the record of the opening call."""
    record, text = await _open_robot(session, robot, option)
    if text is not None:
        session.report(ConnectStepUpdate(ConnectStep.ROBOT, True, text))
        session.open_halt_connection(robot)
    return record


async def start_robslave(session: ControllerSession) -> HistoryRecord:
    """Start the task RobSlave for one cycle. Return the record of the last call."""
    opener, controller = session.opener, session.controller

    async def steps() -> None:
        task = await opener.open_child(controller, ObjectClass.TASK, ROBSLAVE)
        await Task(opener.session, task).start(ONE_CYCLE)

    return await session.record_calls(steps())


@contextmanager
def _reported_step(session: ControllerSession, step: ConnectStep) -> Iterator[list[Message | str]]:
    """Report the start and the end of a step. The caller adds the step's result to the yielded list."""
    session.report(ConnectStepUpdate(step, None))
    result: list[Message | str] = []
    try:
        yield result
    except (BcapError, OSError) as error:
        reason = error_reason(error)
        if isinstance(error, ConnectStepError):
            reason = error.reason
        elif isinstance(error, CallTimeout):
            reason = failure_reason(session.last_record)
        session.report(ConnectStepUpdate(step, False, reason))
        raise ConnectStepError(reason) from error
    session.report(ConnectStepUpdate(step, True, tuple(result)))


async def _open_robot(
    session: ControllerSession, name: str, option: str
) -> tuple[HistoryRecord, Reason | None]:
    """Open and select a robot. Return the record of the call that opens the robot, and the robot's name and
    type. On failure, return None instead of name and type.
    """
    robot = await session.open_object(session.controller, ObjectClass.ROBOT, name, option)
    record = session.last_record
    if robot is None:
        return record, None
    session.update_status(robot=robot)
    return record, (name, await _read_robot_type(session, robot))


async def _identify_controller(session: ControllerSession) -> Reason:
    opener, controller = session.opener, session.controller
    simulator = await opener.is_simulator()
    version = await _read_fact(session, Controller(opener.session, controller.handle), "@VERSION")
    session.arming.is_required = not simulator
    session.update_status(identity=ControllerIdentity(simulator, version))
    kind = Message("controller.kind.simulator" if simulator else "controller.kind.controller")
    return (kind, Message("controller.version", version=version)) if version else (kind,)


async def _read_robot_type(session: ControllerSession, robot: ObjectHandle) -> str:
    """Read the type of the robot, which the user should check before the first motion (DENSO Wave 2009)."""
    remote_robot = Robot(session.opener.session, robot.handle)
    name = await _read_fact(session, remote_robot, "@TYPE_NAME")
    number = await _read_fact(session, remote_robot, "@TYPE")
    session.update_status(identity=replace(session.status.identity, type_name=name, type_number=number))
    return " ".join(filter(None, (name, f"(@TYPE {number})" if number else "")))


async def _read_fact(session: ControllerSession, owner: Controller | Robot, name: str) -> str:
    """Read a system variable once; return "" if the controller lacks it or does not answer."""
    try:
        value = await session.run_calls(read_variable_once(owner, name), Initiator.SCREEN)
    except (CallTimeout, RemoteProtocolError):
        return ""
    if value is None or value == EMPTY:
        return ""
    return value.value if isinstance(value.value, str) else value_text(value.value, value.vt)
