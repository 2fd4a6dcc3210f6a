"""What is open, and what its handle stands for."""

from __future__ import annotations

from bcapscope.client.handle_table import HandleTable, ObjectHandle
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import ObjectClass, function_by_name


def _note(table: HandleTable, name: str, *values: object, handle: int | None = None) -> ObjectHandle | None:
    function = function_by_name(name)
    assert function is not None
    arguments = tuple(
        value if isinstance(value, Variant) else Variant(VT.I4 if isinstance(value, int) else VT.BSTR, value)  # type: ignore[arg-type]  # numbers and texts
        for value in values
    )
    result = () if handle is None else (Variant(VT.I4, handle),)
    table.record_call(function, arguments, Frame(encode_frame(1, 0, 0, result)))
    return None if function.creates is None else table.find(function.creates, handle)


def _with_robot() -> tuple[HandleTable, ObjectHandle, ObjectHandle]:
    table = HandleTable()
    controller = _note(table, "Controller_Connect", "rc", "CaoProv.DENSO.VRC", "localhost", "", handle=1)
    assert controller is not None
    robot = _note(table, "Controller_GetRobot", 1, "Gundam", "", handle=1)
    assert robot is not None
    return table, controller, robot


def test_handles_are_known_by_what_was_asked_for() -> None:
    table, controller, robot = _with_robot()
    assert controller.opened_with == ("rc", "CaoProv.DENSO.VRC", "localhost", "")
    assert (robot.label, robot.parent) == ("Gundam", controller)
    assert table.find(ObjectClass.ROBOT, 1) == robot
    assert table.find(ObjectClass.TASK, 1) is None
    assert table.open_handles() == (controller, robot)
    assert table.latest(ObjectClass.ROBOT) == robot
    assert table.find_named(ObjectClass.ROBOT, "Gundam", controller) == robot
    assert table.find_named(ObjectClass.ROBOT, "Arm", controller) is None


def test_what_is_released_is_forgotten() -> None:
    table, controller, robot = _with_robot()
    _note(table, "Robot_Release", robot.handle)
    assert table.open_handles() == (controller,)


def test_with_the_controller_goes_all_that_was_opened_through_it() -> None:
    table, controller, _ = _with_robot()
    _note(table, "Robot_GetVariable", 1, "@CURRENT_ANGLE", "", handle=9)
    _note(table, "Controller_Disconnect", controller.handle)
    assert table.open_handles() == ()


def test_objects_of_a_controller_that_is_disconnected_must_still_be_released() -> None:
    table, controller, robot = _with_robot()
    _note(table, "Controller_Disconnect", controller.handle)
    assert table.unreleased_handles() == (robot,)
    _note(table, "Controller_Connect", *controller.opened_with, handle=1)
    assert table.open_handles() == (controller,)


def test_recording_a_call_again_changes_nothing() -> None:
    table, controller, robot = _with_robot()
    _note(table, "Controller_Connect", *controller.opened_with, handle=1)
    assert table.open_handles() == (controller, robot)


def test_the_end_of_the_service_is_the_end_of_all() -> None:
    table, _, _ = _with_robot()
    _note(table, "Service_Stop")
    assert table.open_handles() == ()


def test_an_answer_without_a_handle_opens_nothing() -> None:
    table, _, _ = _with_robot()
    assert _note(table, "Controller_GetRobot", 1, "Arm", "") is None


def test_what_has_no_name_is_called_by_its_number() -> None:
    table, _, _ = _with_robot()
    message = _note(table, "Controller_GetMessage", 1, handle=3)
    assert message is not None
    assert message.label == "Message 3"
