"""Calls to which everything happens that a renderer of calls has to show."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.handle_tracker import HandleTracker, TrackedObject
from bcapscope.traffic.observation import Transport
from tests.render.scenes import HOSTILE
from tests.traffic.playbook import (
    CONNECT,
    GET_ROBOT,
    MOVE,
    OTHER,
    POSE,
    S_BUF_FULL,
    S_EXECUTING,
    START_SERVICE,
    Script,
    execute,
    i4,
    text,
)


def script() -> Script:
    found = Script()
    robot = found.client()
    robot.reply(0, 900)
    robot.ask(1, 910, 909, MOVE)
    robot.reply(1.5, 910, 909, 0, POSE)
    robot.ask(2, 1, 0, START_SERVICE)
    robot.reply(3, 1)
    robot.ask(4, 2, 0, (CONNECT, (text("b"), text("CaoProv.DENSO.VRC"), text("localhost"), text(""))))
    robot.reply(5, 2, 0, 0, i4(1))
    robot.ask(6, 3, 0, (GET_ROBOT, (i4(1), text("Arm"), text(""))))
    robot.reply(7, 3, 0, 0, i4(1))
    robot.ask(16, 4, 0, MOVE)
    robot.ask(18, 5, 4, MOVE)
    robot.ask(20, 6, 4, MOVE)
    robot.reply(20.4, 5, 0, 0, POSE)
    robot.reply(21.2, 6, 0, 0, POSE)
    robot.ask(24, 7, 0, OTHER)
    robot.reply(24.9, 7, 0, S_BUF_FULL, POSE)
    robot.reply(24.95, 7, 0, S_BUF_FULL, POSE)
    robot.ask(32, 8, 0, execute("Motor"))
    robot.reply(132, 8, 0, S_EXECUTING)
    robot.reply(160.5, 8, 0, 0x81501025)
    robot.ask(170, 9, 0, execute(HOSTILE))
    robot.ask(180, 10, 0, (GET_ROBOT, (i4(1), text(HOSTILE * 3), text(""))))
    robot.reply(181, 10, 0, 0, i4(2))
    robot.ask(190, 11, 0, execute("GetSpeed", 2))
    robot.reply(191, 11, 0, 0x600B)
    other = found.client(40000, Transport.TCP)
    other.ask(200, 1, 0, (200, ()))
    robot.reply(4000, 9)
    other.ask(4001, 2, 0, (2, ()))
    return found


def settled() -> Iterator[tuple[PairingResult, TrackedObject | None]]:
    """Yield what settles, each with the object that it was asked of."""
    handles = HandleTracker()
    for item in script().track():
        yield item, handles.on_call(item) if isinstance(item, Call) else None
