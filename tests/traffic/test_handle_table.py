"""What is open, and what its handle stands for."""

from __future__ import annotations

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import ObjectClass, function_by_name
from bcapscope.traffic.handle_table import HandleTable, ObjectHandle


def _note(book: HandleTable, name: str, *values: object, handle: int | None = None) -> ObjectHandle | None:
    function = function_by_name(name)
    assert function is not None
    arguments = tuple(
        value if isinstance(value, Variant) else Variant(VT.I4 if isinstance(value, int) else VT.BSTR, value)  # type: ignore[arg-type]  # numbers and texts
        for value in values
    )
    result = () if handle is None else (Variant(VT.I4, handle),)
    return book.record_call(function, arguments, Frame(encode_frame(1, 0, 0, result)))


def _with_robot() -> tuple[HandleTable, ObjectHandle, ObjectHandle]:
    book = HandleTable()
    controller = _note(book, "Controller_Connect", "rc", "CaoProv.DENSO.VRC", "localhost", "", handle=1)
    assert controller is not None
    robot = _note(book, "Controller_GetRobot", 1, "Gundam", "", handle=1)
    assert robot is not None
    return book, controller, robot


def test_handles_are_known_by_what_was_asked_for() -> None:
    book, controller, robot = _with_robot()
    assert controller.opened_with == ("rc", "CaoProv.DENSO.VRC", "localhost", "")
    assert (robot.label, robot.parent) == ("Gundam", controller)
    assert book.find(ObjectClass.ROBOT, 1) == robot
    assert book.find(ObjectClass.TASK, 1) is None
    assert book.open_handles() == (controller, robot)
    assert book.open_handles(ObjectClass.ROBOT) == (robot,)


def test_what_is_released_is_forgotten() -> None:
    book, controller, robot = _with_robot()
    _note(book, "Robot_Release", robot.handle)
    assert book.open_handles() == (controller,)


def test_with_the_controller_goes_all_that_was_opened_through_it() -> None:
    book, controller, _ = _with_robot()
    _note(book, "Robot_GetVariable", 1, "@CURRENT_ANGLE", "", handle=9)
    _note(book, "Controller_Disconnect", controller.handle)
    assert book.open_handles() == ()


def test_the_end_of_the_service_is_the_end_of_all() -> None:
    book, _, _ = _with_robot()
    _note(book, "Service_Stop")
    assert book.open_handles() == ()


def test_an_answer_without_a_handle_opens_nothing() -> None:
    book, _, _ = _with_robot()
    assert _note(book, "Controller_GetRobot", 1, "Arm", "") is None


def test_what_has_no_name_is_called_by_its_number() -> None:
    book, _, _ = _with_robot()
    message = _note(book, "Controller_GetMessage", 1, handle=3)
    assert message is not None
    assert message.label == "Message 3"
