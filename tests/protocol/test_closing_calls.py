"""The calls that close a session."""

from __future__ import annotations

import pytest

from bcapscope.protocol.closing_calls import closing_calls
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.function_table import ObjectClass


def test_slave_mode_ends_before_the_arm_and_the_objects_are_released() -> None:
    calls = list(closing_calls([7], [7, 8], [(ObjectClass.ROBOT, 7), (ObjectClass.CONTROLLER, 5)]))
    assert [(call_name(code, values), [each.value for each in values]) for code, values in calls] == [
        ("Robot_Execute slvChangeMode", [7, "slvChangeMode", 0]),
        ("Robot_Execute GiveArm", [7, "GiveArm", None]),
        ("Robot_Execute GiveArm", [8, "GiveArm", None]),
        ("Robot_Release", [7]),
        ("Controller_Disconnect", [5]),
        ("Service_Stop", []),
    ]


@pytest.mark.parametrize("stops", [True, False])
def test_the_service_is_stopped_on_demand(stops: bool) -> None:
    calls = [call_name(code, values) for code, values in closing_calls([], [], [], stops_service=stops)]
    assert calls == (["Service_Stop"] if stops else [])
