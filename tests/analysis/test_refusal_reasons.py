"""The reason that a refusal names is never refuted by the capture, and links the refusal to its cause."""

from __future__ import annotations

import pytest

from tests.analysis.scenes import CONTROLLER, HOME, ROBOT, Diagnosed, Play, Story, Talker, stage
from tests.samples.calls import i4, i4s, r8s, text
from tests.samples.findings import sentence_of

_TOKEN, _STOP, _NO_ARM, _NO_MOTOR, _OUTSIDE = 0x83501028, 0x8150101A, 0x83501024, 0x81501003, 0x83500121
_UNDERFLOW, _INVALID, _HANDLE, _ACTIVE = 0x84201482, 0x80070057, 0x80070006, 0x81501025


def _unanswered(client: Talker, ms: float, command: str) -> None:
    client.ask(ms, "Robot_Execute", ROBOT, text(command), i4s(1, 0))


def _after(prepare: Play, command: str, code: int) -> Diagnosed:
    """Diagnose a session in which, after `prepare`, a command at 400 ms is refused."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        prepare(story)
        client.execute(400, command, i4(0x202), code=code)
        client.close(500)

    return stage(play)


def _takes_refused(story: Story) -> None:
    story.talkers[0].execute(50, "TakeArm", i4s(0, 0), code=_TOKEN)


def _takes_unanswered(story: Story) -> None:
    _unanswered(story.talkers[0], 50, "TakeArm")
    story.talkers[0].execute(300, "CurJnt")


def _gives_back(story: Story) -> None:
    story.talkers[0].execute(50, "TakeArm", i4s(0, 0))
    story.talkers[0].execute(60, "GiveArm")


def _gives_back_unanswered(story: Story) -> None:
    story.talkers[0].execute(50, "TakeArm", i4s(0, 0))
    _unanswered(story.talkers[0], 60, "GiveArm")
    story.talkers[0].execute(300, "CurJnt")


def _takes_again_refused(story: Story) -> None:
    _gives_back(story)
    story.talkers[0].execute(70, "TakeArm", i4s(0, 0), code=_STOP)


def _loses_by_error(story: Story) -> None:
    story.talkers[0].execute(50, "TakeArm", i4s(0, 0))
    story.talkers[0].execute(60, "Motor", i4s(1, 0), code=0x84201414)


@pytest.mark.parametrize(
    ("prepare", "words", "cause"),
    [
        (_takes_refused, "TakeArm 5 was refused at 0.050 s (0x83501028)", "no-executable-token"),
        (_takes_unanswered, "holds no reply to TakeArm 5, sent at 0.050 s", "no-reply"),
        (_gives_back, "GiveArm 6 had given the arm back at 0.060 s", ""),
        (_gives_back_unanswered, "GiveArm 6 at 0.060 s may have given the arm back", "no-reply"),
        (_takes_again_refused, "TakeArm 7 was refused at 0.070 s (0x8150101A)", "emergency-stop"),
        (_loses_by_error, "the arm was taken at 0.050 s and was lost since then", "over-limit"),
    ],
)
def test_an_arm_that_is_not_held(prepare: Play, words: str, cause: str) -> None:
    found = _after(prepare, "slvChangeMode", _NO_ARM)
    (finding,) = found.of("arm-not-taken")
    assert words in sentence_of(finding, found.seen)
    assert "no TakeArm" not in sentence_of(finding, found.seen)
    assert _cause(found, "arm-not-taken") == cause


@pytest.mark.parametrize("code", [0, _INVALID])
def test_reading_a_variable_with_the_name_of_a_command_is_no_such_command(code: int) -> None:
    def reads(story: Story) -> None:
        client = story.talkers[0]
        client.call(50, "Controller_GetVariable", CONTROLLER, text("TakeArm"), text(""), result=i4(7))
        client.call(60, "Variable_GetValue", i4(7), result=i4(1), code=code)

    found = _after(reads, "slvChangeMode", _NO_ARM)
    (finding,) = found.of("arm-not-taken")
    assert "the capture shows no TakeArm of this client" in sentence_of(finding, found.seen)


def test_a_takearm_of_an_earlier_session_does_not_refute_the_reason() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.close(50)
        client.open(100)
        client.execute(200, "slvChangeMode", i4(0x202), code=_NO_ARM)
        client.close(300)

    found = stage(play)
    (finding,) = found.of("arm-not-taken")
    assert "no TakeArm of this client in this session" in sentence_of(finding, found.seen)


def _motor_refused(story: Story) -> None:
    story.talkers[0].execute(50, "Motor", i4s(1, 0), code=_STOP)


def _motor_unanswered(story: Story) -> None:
    _unanswered(story.talkers[0], 50, "Motor")
    story.talkers[0].execute(300, "CurJnt")


def _motor_by_variable_refused(story: Story) -> None:
    client = story.talkers[0]
    client.call(50, "Robot_GetVariable", ROBOT, text("@SERVO_ON"), text(""), result=i4(9))
    client.call(60, "Variable_PutValue", i4(9), i4(1), code=_STOP)


def _motor_off_by_other(story: Story) -> None:
    story.talkers[0].execute(50, "Motor", i4s(1, 0))
    other = story.client(50002)
    other.open(100)
    other.execute(200, "Motor", i4s(0, 0))


@pytest.mark.parametrize(
    ("prepare", "words", "cause"),
    [
        (_motor_refused, "Motor 5 was refused at 0.050 s (0x8150101A)", "emergency-stop"),
        (_motor_unanswered, "holds no reply to Motor 5", "no-reply"),
        (_motor_by_variable_refused, "Variable_PutValue 6 was refused at 0.060 s", "emergency-stop"),
        (_motor_off_by_other, "Motor 5 of client 192.168.0.10:50002 (UDP) switched the motor off", ""),
    ],
)
def test_a_motor_that_is_off(prepare: Play, words: str, cause: str) -> None:
    found = _after(prepare, "DriveEx", _NO_MOTOR)
    (finding,) = found.of("motor-off")
    assert words in sentence_of(finding, found.seen)
    assert "no Motor call" not in sentence_of(finding, found.seen)
    assert _cause(found, "motor-off") == cause


def _cause(found: Diagnosed, rule: str) -> str:
    (finding,) = found.of(rule)
    return found.findings[finding.consequence_of - 1].rule if finding.consequence_of else ""


def _errs(client: Talker) -> float:
    at = client.drive(10)
    client.point(at + 64, 0.5, _UNDERFLOW)
    return at + 80


def test_a_refused_clearerror_is_named_where_the_client_went_on() -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = _errs(client)
        client.control(at, "ClearError", code=_INVALID)
        client.execute(at + 10, "Motor", i4s(1, 0), code=_ACTIVE)
        client.close(at + 20)

    found = stage(play)
    (went_on,) = found.of("went-on-after-error")
    assert "Its ClearError 19 was refused (0x80070057)." in sentence_of(went_on)
    (active,) = found.of("error-not-cleared")
    assert "was not cleared, because ClearError 19 was refused" in sentence_of(active)
    assert _cause(found, "argument-refused") == "underflow"
    assert found.of("cleared-unread") == []


def test_an_unanswered_clearerror_is_named_where_the_client_went_on() -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = _errs(client)
        client.ask(at, "Controller_Execute", CONTROLLER, text("ClearError"), i4(0))
        client.execute(at + 200, "Motor", i4s(1, 0), code=_ACTIVE)
        client.close(at + 220)

    found = stage(play)
    assert "holds no reply to its ClearError 19." in sentence_of(found.of("went-on-after-error")[0])
    assert "may not be cleared" in sentence_of(found.of("error-not-cleared")[0])


def test_an_error_that_another_client_cleared_is_cleared() -> None:
    def play(story: Story) -> None:
        client, other = story.client(), story.client(50002, tcp=True)
        other.open(5)
        at = _errs(client)
        other.control(at, "GetCurErrorCount")
        other.control(at + 5, "ClearError")
        client.execute(at + 10, "Motor", i4s(1, 0))
        client.close(at + 20)
        other.close(at + 40)

    assert [finding.rule for finding in stage(play).findings] == ["set-point-gap", "underflow"]


def _shuts_down(client: Talker, at: float) -> None:
    client.execute(at, "slvChangeMode", i4(0))
    client.execute(at + 10, "Motor", i4s(0, 0))
    client.execute(at + 20, "GiveArm")
    client.control(at + 30, "GetCurErrorCount")
    client.close(at + 40)


def _shuts_down_by_variable(client: Talker, at: float) -> None:
    client.call(at, "Robot_GetVariable", ROBOT, text("@SERVO_ON"), text(""), result=i4(9))
    client.call(at + 5, "Variable_PutValue", i4(9), i4(0))
    client.call(at + 10, "Variable_Release", i4(9))
    client.call(at + 15, "Robot_Halt", ROBOT, text(""))
    client.close(at + 20)


@pytest.mark.parametrize("shuts_down", [_shuts_down, _shuts_down_by_variable])
def test_an_orderly_shutdown_after_an_error_is_not_going_on(shuts_down: object) -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = _errs(client)
        assert callable(shuts_down)
        shuts_down(client, at)

    found = stage(play)
    assert [finding.rule for finding in found.findings] == ["set-point-gap", "underflow"]


def test_motor_on_after_an_error_is_going_on() -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = _errs(client)
        client.execute(at, "Motor", i4s(1, 0))
        _shuts_down(client, at + 10)

    found = stage(play)
    (finding,) = found.of("went-on-after-error")
    assert "made 1 more call " in sentence_of(finding, found.seen)


def test_a_handle_of_a_refused_connect_follows_from_the_refusal() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.call(0, "Service_Start", text(",WDT=400"))
        names = map(text, ("", "CaoProv.DENSO.RC8", "localhost", ""))
        client.call(5, "Controller_Connect", *names, code=0x80000201)
        client.call(10, "Controller_GetRobot", i4(0), text("Arm"), text(""), code=_HANDLE)
        client.call(15, "Robot_Execute", i4(0), text("CurJnt"), i4(0), code=_HANDLE)
        client.call(20, "Service_Stop")

    found = stage(play)
    assert [finding.rule for finding in found.findings] == ["provider-refused", "bad-handle"]
    (finding,) = found.of("bad-handle")
    assert "Controller_Connect 2, which should have given a handle, was refused" in sentence_of(
        finding, found.seen
    )
    assert _cause(found, "bad-handle") == "provider-refused"


@pytest.mark.parametrize("code", [0x80000902, 0x80070006, 0x80004005])
def test_what_follows_from_a_refused_service_start(code: int) -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.call(0, "Service_Start", text(",WDT=20"), code=_INVALID)
        names = map(text, ("", "CaoProv.DENSO.VRC", "localhost", ""))
        client.call(5, "Controller_Connect", *names, code=code)

    found = stage(play)
    assert [finding.rule for finding in found.findings] == ["wdt-too-small", "service-not-started"]
    assert _cause(found, "service-not-started") == "wdt-too-small"


@pytest.mark.parametrize("code", [0x80000902, 0x80070006])
def test_what_follows_from_a_first_request_with_serial_0(code: int) -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.call(0, "Service_Start", text(",WDT=400"), serial=0)
        names = map(text, ("", "CaoProv.DENSO.VRC", "localhost", ""))
        client.call(5, "Controller_Connect", *names, code=code)

    found = stage(play)
    assert [finding.rule for finding in found.findings] == ["serial-zero", "service-not-started"]
    assert _cause(found, "service-not-started") == "serial-zero"


def test_a_first_captured_request_with_serial_0_in_mid_session_is_no_finding() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.serial = -1
        for ms in range(0, 100, 10):
            client.execute(ms, "CurJnt", result=r8s(*HOME))

    assert stage(play).findings == ()


def test_a_refusal_by_the_robot_in_mid_session_is_not_blamed_on_service_start() -> None:
    def play(story: Story) -> None:
        story.client(tcp=True).execute(0, "slvChangeMode", i4(0x202), code=_NO_ARM)

    found = stage(play)
    (finding,) = found.findings
    assert finding.rule == "arm-not-taken"
    assert sentence_of(finding, found.seen).endswith("the capture shows no TakeArm of this client.")


def test_a_first_call_that_is_refused_for_a_reason_of_its_own_is_not_blamed_on_service_start() -> None:
    def play(story: Story) -> None:
        names = map(text, ("", "CaoProv.DENSO.VRC", "localhost", ""))
        story.client().call(0, "Controller_Connect", *names, serial=2, code=0x8000020C)

    assert [finding.rule for finding in stage(play).findings] == ["no-licence"]


def test_a_long_move_without_wdt_explains_that_the_client_gave_up() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open(option="")
        client.ready()
        move = ROBOT, i4(1), text("@E P1"), text("")
        first = client.ask(40, "Robot_Move", *move)
        client.ask(3040, "Robot_Move", *move, reserved=first)
        client.execute(6050, "CurJnt", code=0x809100AA)
        client.answer(9040, first)
        client.close(9100)

    found = stage(play)
    rules = [finding.rule for finding in found.findings]
    assert rules == ["long-call-without-wdt", "client-gave-up", "busy"]
    assert _cause(found, "client-gave-up") == "long-call-without-wdt"


@pytest.mark.parametrize(
    ("code", "words", "cause"),
    [
        (_NO_ARM, "slvChangeMode 5 was refused at 0.050 s", "arm-not-taken"),
        (None, "holds no reply to slvChangeMode 5, sent at 0.050 s", "no-reply"),
    ],
)
def test_a_set_point_after_a_mode_change_without_success(code: int | None, words: str, cause: str) -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        if code is None:
            client.ask(50, "Robot_Execute", ROBOT, text("slvChangeMode"), i4(0x202))
        else:
            client.execute(50, "slvChangeMode", i4(0x202), code=code)
        client.point(300, 0.0, _OUTSIDE)
        client.point(308, 0.0, _OUTSIDE)
        client.close(400)

    found = stage(play)
    assert words in sentence_of(found.of("slvmove-outside-slave-mode")[0], found.seen)
    assert _cause(found, "slvmove-outside-slave-mode") == cause


def test_a_session_that_was_closed_without_a_captured_reply_is_not_left_open() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.call(50, "Controller_Disconnect", CONTROLLER)
        client.ask(60, "Service_Stop")
        client.open(3000)
        client.close(3100)

    assert stage(play).of("unclean-quit") == []


@pytest.mark.parametrize(("answered", "wanted"), [(False, []), (None, ["quit-in-slave-mode"])])
def test_a_client_that_may_have_left_slave_mode_did_not_quit_in_it(
    answered: bool | None, wanted: list[str]
) -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(20)
        if answered is False:
            client.ask(at, "Robot_Execute", ROBOT, text("slvChangeMode"), i4(0))
        client.close(at + 300)

    assert [each.rule for each in stage(play).of("quit-in-slave-mode")] == wanted


def test_without_replies_it_is_a_guess_that_a_client_quit_in_slave_mode() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ask(50, "Robot_Execute", ROBOT, text("slvChangeMode"), i4(0x202))
        for number in range(5):
            client.ask(100 + 8 * number, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME))
        client.call(300, "Robot_Release", ROBOT)
        client.close(400)

    found = stage(play)
    (finding,) = found.of("quit-in-slave-mode")
    assert "This is a guess" in sentence_of(finding, found.seen)


def test_set_points_that_the_capture_lacks_are_no_gap() -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(40)
        client.serial += 8
        client.leave(client.move(at + 64, 40, first=48 * 0.05))

    assert stage(play).of("set-point-gap") == []
