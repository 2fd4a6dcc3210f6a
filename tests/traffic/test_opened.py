"""What is open, and what its handle stands for."""

from __future__ import annotations

from bcapscope.protocol.frame import Frame, encode
from bcapscope.protocol.functions import ObjectClass, function_by_name
from bcapscope.protocol.variant import VT, Variant
from bcapscope.traffic.opened import Book, Opened


def _note(book: Book, name: str, *values: object, handle: int | None = None) -> Opened | None:
    function = function_by_name(name)
    assert function is not None
    arguments = tuple(
        value if isinstance(value, Variant) else Variant(VT.I4 if isinstance(value, int) else VT.BSTR, value)  # type: ignore[arg-type]  # numbers and texts
        for value in values
    )
    result = () if handle is None else (Variant(VT.I4, handle),)
    return book.note(function, arguments, Frame(encode(1, 0, 0, result)))


def _with_robot() -> tuple[Book, Opened, Opened]:
    book = Book()
    controller = _note(book, "Controller_Connect", "rc", "CaoProv.DENSO.VRC", "localhost", "", handle=1)
    assert controller is not None
    robot = _note(book, "Controller_GetRobot", 1, "Gundam", "", handle=1)
    assert robot is not None
    return book, controller, robot


def test_handles_are_known_by_what_was_asked_for() -> None:
    book, controller, robot = _with_robot()
    assert controller.asked == ("rc", "CaoProv.DENSO.VRC", "localhost", "")
    assert (robot.label, robot.parent) == ("Gundam", controller)
    assert book.find(ObjectClass.ROBOT, 1) == robot
    assert book.find(ObjectClass.TASK, 1) is None
    assert book.all() == (controller, robot)
    assert book.all(ObjectClass.ROBOT) == (robot,)


def test_what_is_released_is_forgotten() -> None:
    book, controller, robot = _with_robot()
    _note(book, "Robot_Release", robot.handle)
    assert book.all() == (controller,)


def test_with_the_controller_goes_all_that_was_opened_through_it() -> None:
    book, controller, _ = _with_robot()
    _note(book, "Robot_GetVariable", 1, "@CURRENT_ANGLE", "", handle=9)
    _note(book, "Controller_Disconnect", controller.handle)
    assert book.all() == ()


def test_the_end_of_the_service_is_the_end_of_all() -> None:
    book, _, _ = _with_robot()
    _note(book, "Service_Stop")
    assert book.all() == ()


def test_an_answer_without_a_handle_opens_nothing() -> None:
    book, _, _ = _with_robot()
    assert _note(book, "Controller_GetRobot", 1, "Arm", "") is None


def test_what_has_no_name_is_called_by_its_number() -> None:
    book, _, _ = _with_robot()
    message = _note(book, "Controller_GetMessage", 1, handle=3)
    assert message is not None
    assert message.label == "Message 3"
