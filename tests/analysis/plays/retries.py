"""Retries that break the rules, and serials that lead to mistakes."""

from __future__ import annotations

from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import HOME, ROBOT, Play, Story, good
from tests.samples.calls import i4, r8s, text

_POSE = r8s(*HOME)
_MOVE = (ROBOT, text("slvMove"), _POSE)
_MOTOR = (ROBOT, text("Motor"), i4(1))
_START = (text(""),)


def _retried_point(mode: int, after: float) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.enter(40, mode)
        client.move(50, 4)
        first = client.ask(82, "Robot_Execute", *_MOVE)
        again = client.ask(82 + after, "Robot_Execute", *_MOVE, reserved=first)
        client.answer(83 + after, again, _POSE, reserved=first)
        client.move(90 + after, 4)

    return play


def _again(reserved: int, answered: bool = False) -> Play:
    """A Motor that is sent again with `reserved` added to the first serial, or 0 for none."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        first = client.ask(50, "Robot_Execute", *_MOTOR)
        if answered:
            client.answer(51, first)
        again = client.ask(1050, "Robot_Execute", *_MOTOR, reserved=reserved and first + reserved - 100)
        client.answer(1051, again)
        client.close(1100)

    return play


def _repeats_point(step: float) -> Play:
    """Two set points of one pose, neither answered, after some that were each `step` further on."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.enter(40)
        at = client.move(50, 4, first=-4 * step, step=step)
        client.ask(at, "Robot_Execute", *_MOVE)
        client.ask(at + 8, "Robot_Execute", *_MOVE)
        client.leave(client.move(at + 16, 4, step=step))

    return play


def _serial_zero(story: Story) -> None:
    client = story.client()
    client.call(0, "Service_Start", *_START, serial=0)
    client.call(5, "Service_Stop")


def _wraps_through_zero(story: Story) -> None:
    client = story.client()
    client.call(0, "Service_Start", *_START, serial=65535)
    client.call(5, "Service_Stop", serial=0)


def _reuses_serial(waits: float) -> Play:
    """A client that goes on after `waits` ms with the same serial, and has its reply after 30 ms."""

    def play(story: Story) -> None:
        client = story.client(tcp=True)
        client.open()
        first = client.ask(50, "Robot_Execute", *_MOTOR, serial=9)
        if waits > 30:
            client.answer(80, first)
        second = client.ask(50 + waits, "Robot_Execute", ROBOT, text("CurJnt"), i4(0), serial=9)
        if waits < 30:
            client.answer(80, first)
        client.answer(90, second, _POSE)

    return play


def _restarts(serial: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.close(40)
        client.call(2000, "Service_Start", *_START, serial=serial)
        client.call(2010, "Service_Stop")

    return play


def _two_conventions(story: Story) -> None:
    client = story.client()
    client.open()
    for step, (first, second, third) in enumerate(((0, 100, 100), (0, 200, 201))):
        at = 100.0 + 100 * step
        serial = 100 + 100 * step
        client.ask(at, "Robot_Execute", *_MOVE, serial=serial, reserved=first)
        client.ask(at + 2, "Robot_Execute", *_MOVE, reserved=second)
        last = client.ask(at + 4, "Robot_Execute", *_MOVE, reserved=third)
        client.answer(at + 5, last, _POSE)
    client.close(300)


SCENES = (
    Scene(
        "retry-in-async",
        _retried_point(0x102, 2),
        (20,),
        ("sent 1 retry for 9 set points in mode 0x102", "the newest set point counts"),
        _retried_point(0x202, 2),
    ),
    Scene(
        "wrong-reserved",
        _again(142),
        (9, 10, 11),
        ("Motor 6 repeats Motor 5", "its reserved field is 47 instead of 5"),
        _again(100),
    ),
    Scene(
        "unmarked-retry",
        _again(0),
        (9, 10, 11),
        ("Motor 6 repeats Motor 5, to which the capture holds no reply. It is sent as a new call",),
        _again(0, answered=True),
        "no-reply",
    ),
    Scene(
        "unmarked-retry",
        _repeats_point(0.05),
        (19, 20),
        ("slvMove 11 repeats slvMove 10",),
        _repeats_point(0.0),
        "no-reply",
    ),
    Scene("serial-zero", _serial_zero, (1, 2), ("Service_Start, has serial 0",), _wraps_through_zero),
    Scene(
        "serial-reused",
        _reuses_serial(20),
        (9, 10, 11, 12),
        (
            "sent CurJnt with serial 9, 20 ms after Motor with the same serial",
            "The reply at 0.080 s belongs to Motor",
        ),
        _reuses_serial(35),
        "client-gave-up",
    ),
    Scene(
        "stale-answer",
        _restarts(7),
        (13, 14, 15, 16),
        ("has serial 7, which was also the serial of the last reply",),
        _restarts(9),
    ),
    Scene(
        "slow-retry",
        _retried_point(0x202, 16),
        (19, 20, 21),
        ("waited 16 ms before it retried slvMove 10",),
        _retried_point(0x202, 2),
    ),
    Scene("mixed-conventions", _two_conventions, (9, 10, 11, 12), ("'seed'", "'chain'"), good),
)
