"""What must be done before the robot moves."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import CONTROLLER, HOME, ROBOT, Play, Story, good
from tests.samples.calls import i2, i4, i4s, mixed, r4s, r8s, text

_RC7_POSE = r4s(*HOME)


def _rc7(starts: bool, code: int, fails_between: bool = False) -> Play:
    """A session on an RC7 up to slvChangeMode, which ends with `code`."""

    def play(story: Story) -> None:
        client = story.client()
        client.open(option="", provider="")
        client.control(20, "PutAutoMode", i2(2))
        if starts:
            client.call(25, "Controller_GetTask", CONTROLLER, text("RobSlave"), text(""), result=i4(3))
            client.call(30, "Task_Start", i4(3), i4(1), text(""))
        if fails_between:
            client.execute(35, "slvChangeMode", i2(2))
            client.execute(40, "slvMove", _RC7_POSE, EMPTY, code=0x6413)
            client.control(45, "ClearError")
        client.execute(50, "slvChangeMode", i2(2), code=code)
        client.execute(55, "slvChangeMode", i2(0))
        client.close(60)

    return play


def _without_robslave(there: bool) -> Play:
    """A session on an RC7 that may not have the program."""

    def play(story: Story) -> None:
        client = story.client()
        client.open(option="", provider="")
        task = (CONTROLLER, text("RobSlave"), text(""))
        if there:
            client.call(25, "Controller_GetTask", *task, result=i4(3))
            client.call(30, "Task_Start", i4(3), i4(1), text(""))
        else:
            client.call(25, "Controller_GetTask", *task, code=0x80000204)
        client.execute(50, "slvChangeMode", i2(2), code=0 if there else 0x80004005)
        client.execute(55, "slvChangeMode", i2(0))
        client.close(60)

    return play


def _takes_arm_of_nobody(code: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.execute(20, "TakeArm", i4s(0, 0), code=code)
        client.close(40)

    return play


def _moves_to_first(passing: str, code: int = 0, takes: float = 1.0) -> Play:
    """A Robot_Move and then slvChangeMode."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        pose = mixed(r8s(*HOME), text("J"), text(passing)) if passing else text("J(0,10,80,0,90,0)")
        client.call(40, "Robot_Move", ROBOT, i4(1), pose, text(""))
        client.execute(45, "slvChangeMode", i4(0x202), code=code, takes=takes)
        client.execute(900, "slvChangeMode", i4(0))
        client.close(910)

    return play


def _motor(code: int, first: str = "") -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        if first:
            client.execute(25, first, i4s(0, 0))
        client.execute(30, "Motor", i4s(1, 0), code=code)
        client.close(40)

    return play


def _arm(other_takes_it: bool) -> Play:
    def play(story: Story) -> None:
        other = story.client(50002)
        other.open()
        other.execute(20, "TakeArm" if other_takes_it else "CurJnt", i4s(0, 0))
        other.execute(30, "CurJnt", result=r8s(*HOME))
        client = story.client()
        client.open(200)
        client.execute(300, "slvChangeMode", i4(0x202), code=0x83501024)
        client.close(310)
        other.close(400)

    return play


def _moves_without_motor(code: int, switches_on: bool = True) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.execute(20, "TakeArm", i4s(0, 0))
        if switches_on:
            client.execute(25, "Motor", i4s(1, 0))
            client.execute(30, "Motor", i4s(0, 0))
        client.execute(40, "slvChangeMode", i4(0x202), code=code)
        client.execute(50, "slvChangeMode", i4(0))
        client.close(60)

    return play


def _error_before(code: int, again: bool = False, state: int = 1) -> Play:
    """A motion fails after Motor on; Motor may be called once more before the next motion is refused."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.call(30, "Robot_Move", ROBOT, i4(1), text("@E P1"), text(""), code=code)
        if again:
            client.execute(35, "Motor", i4s(state, 0))
        client.execute(40, "DriveEx", code=0x81501003)
        client.close(50)

    return play


def _type_unread(story: Story) -> None:
    client = story.client()
    client.call(0, "Service_Start", text(",WDT=400"))
    client.call(5, "Robot_Move", ROBOT, i4(1), text("@E P1"), text(""))


SCENES = (
    Scene(
        "robslave-not-running",
        _rc7(starts=False, code=0x80004005),
        (11, 12),
        ("slvChangeMode 6 of your client", "the capture shows no Task_Start of RobSlave"),
        _rc7(starts=True, code=0),
    ),
    Scene(
        "robslave-not-running",
        _rc7(starts=True, code=0x80004005, fails_between=True),
        (17, 18, 21, 22),
        (
            "Task_Start 7 started RobSlave",
            "the error of slvMove 9 stopped it",
            "the capture shows no start after that",
        ),
        _rc7(starts=True, code=0x80004005),
        "controller-error",
    ),
    Scene(
        "robslave-not-running",
        _without_robslave(there=False),
        (9, 10, 12),
        (
            "Controller_GetTask 5 of your client",
            "the controller has no program of that name",
            "This happened twice",
        ),
        _without_robslave(there=True),
    ),
    Scene(
        "no-at-e",
        _moves_to_first("@P", 0x600B, 500),
        (13, 14, 15, 16),
        (
            "Robot_Move 7, has @P instead of @E. slvChangeMode waited 500 ms",
            "slvChangeMode was refused",
            "0x0000600B",
        ),
        _moves_to_first("@E"),
    ),
    Scene(
        "no-at-e",
        _moves_to_first("", 0, 300),
        (13, 14, 15, 16),
        ("Robot_Move 7, has no @E",),
        _moves_to_first("@P"),
    ),
    Scene(
        "robot-still-moving",
        _moves_to_first("@P", 0x8150100D, 500),
        (13, 14, 15, 16),
        ("slvChangeMode 8 of your client", "Robot_Move 7 was sent 5.0 ms earlier"),
        _moves_to_first("@P", 0, 400),
        "no-at-e",
    ),
    Scene(
        "arm-not-taken",
        _arm(False),
        (21, 22),
        ("0x83501024", "the capture shows no TakeArm of this client in this session"),
        _arm(True),
    ),
    Scene(
        "arm-taken-by-other",
        _arm(True),
        (9, 10, 21, 22),
        (
            "client 192.168.0.10:50002 (UDP) took the arm at 0.020 s",
            "the capture shows no successful GiveArm",
        ),
        _arm(False),
    ),
    Scene(
        "arm-taken-by-other",
        _takes_arm_of_nobody(0x83501024),
        (9, 10),
        ("the capture does not show who holds the arm",),
        _takes_arm_of_nobody(0),
    ),
    Scene(
        "motor-off",
        _moves_without_motor(0x81501003),
        (13, 14, 15, 16),
        ("0x81501003", "Motor 7 switched the motor off at 0.030 s"),
        good,
    ),
    Scene(
        "motor-off",
        _error_before(0x84201482),
        (15, 16),
        ("the error of Robot_Move 7 most likely switched the motor off",),
        good,
        "underflow",
    ),
    Scene(
        "motor-off",
        _error_before(0x83500127),
        (15, 16),
        ("the error of Robot_Move 7 may have switched the motor off",),
        good,
    ),
    Scene(
        "motor-off",
        _error_before(0x84201482, again=True),
        (15, 16, 17, 18),
        ("Motor 8 switched the motor on at 0.035 s, and something switched it off since",),
        good,
        "underflow",
    ),
    Scene(
        "motor-off",
        _error_before(0x84201482, again=True, state=0),
        (15, 16, 17, 18),
        ("Motor 8 switched the motor off at 0.035 s",),
        good,
        "underflow",
    ),
    Scene(
        "motor-off",
        _moves_without_motor(0x81501003, switches_on=False),
        (11, 12),
        ("the capture shows no Motor call of this client",),
        good,
    ),
    Scene(
        "motor-switching-off",
        _motor(0x8350106E, "Motor"),
        (11, 12),
        ("Motor 6", "0x8350106E"),
        _motor(0, "Motor"),
    ),
    Scene(
        "emergency-stop",
        _motor(0x8150101A),
        (9, 10),
        ("Motor 5", "0x8150101A", "emergency stop is on"),
        _motor(0),
    ),
    Scene(
        "not-in-automatic-mode", _motor(0x81501017), (9, 10), ("0x81501017", "automatic mode only"), _motor(0)
    ),
    Scene(
        "no-executable-token", _motor(0x83501028), (9, 10), ("0x83501028", "must be Ethernet's"), _motor(0)
    ),
    Scene("no-licence", _motor(0x83500126), (9, 10), ("0x83500126", "licence not registered"), _motor(0)),
    Scene(
        "manual-reset-missing",
        _motor(0x83500372),
        (9, 10),
        ("0x83500372", "ManualResetPreparation missing"),
        _motor(0),
    ),
    Scene(
        "type-not-checked",
        _type_unread,
        (3, 4),
        ("called Robot_Move. The capture shows no earlier call of this session that read the robot's type",),
        good,
    ),
)
