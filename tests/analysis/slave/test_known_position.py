"""Where the robot stands when slave mode begins is known only while nothing can have moved it since."""

from __future__ import annotations

import pytest

from bcapscope.analysis.slave.motion_model import MotionFacts
from bcapscope.protocol.codec.variant import EMPTY
from bcapscope.protocol.tables.function_table import ID
from tests.analysis.driving import ENTER, OFF, Driver, Plan, i4, joints
from tests.traffic.playbook import text


def _last_motion(plan: Plan) -> MotionFacts:
    motion = plan.stays()[-1].motion
    assert motion is not None
    return motion


def _drives(driver: Driver, ms: float, first: float, points: int) -> None:
    """Send set points that are answered without a pose."""
    driver.change(ms, ENTER)
    for number in range(points):
        driver.move(ms + 10 + 8 * number, joints(first + number), result=EMPTY)


@pytest.mark.parametrize("moved_by", ["Robot_Move", "DriveEx of another client", "slave mode", "Task_Start"])
def test_a_position_from_before_a_motion_is_forgotten(moved_by: str) -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(0, "CurJnt", result=joints(0.0))
    if moved_by == "slave mode":
        _drives(driver, 10, 0.5, 50)
        driver.change(500, OFF)
    elif moved_by == "DriveEx of another client":
        plan.driver(50002).execute(10, "DriveEx", text("(1,50)"))
    else:
        driver.call(10, ID[moved_by], i4(1), i4(1), text("@E P1"), text(""))
    _drives(driver, 600, 50.0, 2)
    assert _last_motion(plan).first_distance == ()


def test_a_position_that_is_read_during_slave_mode_is_not_where_it_began() -> None:
    plan = Plan()
    driver = plan.driver()
    _drives(driver, 0, 0.0, 30)
    driver.execute(300, "CurJnt", result=joints(29.0))
    assert _last_motion(plan).first_distance == ()


@pytest.mark.parametrize("command", ["Motor", "TakeArm", "GetSrvData", "ExtSpeed"])
def test_a_call_that_moves_nothing_leaves_the_position_known(command: str) -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(0, "CurJnt", result=joints(0.5))
    driver.execute(10, command)
    _drives(driver, 20, 0.5, 2)
    assert _last_motion(plan).first_distance[:1] == (0.0,)
