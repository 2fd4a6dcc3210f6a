"""Errors of the controller: not cleared, cleared unread, and all that no other rule tells."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import CONTROLLER, Play, Story, good
from tests.samples.calls import i4, i4s, text

_UNDERFLOW, _OUTSIDE, _ACTIVE = 0x84201482, 0x83500121, 0x81501025


def _after_error(*commands: str, code: int = 0) -> Play:
    """A stay that ends with an error, then what the client does about it; the last call ends with `code`."""

    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(10)
        client.point(at + 64, 0.5, _UNDERFLOW)
        at += 80
        for number, command in enumerate(commands, 1):
            ends = code if number == len(commands) else 0
            if command in ("ClearError", "GetCurErrorCount"):
                client.call(
                    at, "Controller_Execute", CONTROLLER, text(command), EMPTY, result=i4(1), code=ends
                )
            else:
                client.execute(at, command, i4s(1, 0), code=ends)
            at += 10
        client.close(at)

    return play


def _outside_slave_mode(*, clears: bool) -> Play:
    """A set point while slave mode is off, which is an error itself, and then Motor."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.point(50, 0.0, _OUTSIDE)
        for at, command in ((60, "GetCurErrorCount"), (70, "ClearError")) if clears else ():
            client.call(at, "Controller_Execute", CONTROLLER, text(command), EMPTY, result=i4(1))
        client.execute(80, "Motor", i4s(1, 0), code=0 if clears else _ACTIVE)
        client.close(90)

    return play


def _refuses(code: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.execute(30, "ExtSpeed", i4(50), code=code)
        client.close(40)

    return play


SCENES = (
    Scene(
        "error-not-cleared",
        _after_error("Motor", code=_ACTIVE),
        (35, 36, 37, 38),
        ("Motor 19 of your client", "0x81501025", "no ClearError after the error of slvMove 18 at 0.194 s"),
        _after_error("GetCurErrorCount", "ClearError", "Motor"),
        "underflow",
    ),
    Scene(
        "error-not-cleared",
        _outside_slave_mode(clears=False),
        (13, 14, 15, 16),
        ("Motor 8 of your client", "no ClearError after the error of slvMove 7 at 0.050 s"),
        _outside_slave_mode(clears=True),
        "slvmove-outside-slave-mode",
    ),
    Scene(
        "went-on-after-error",
        _after_error("Motor", "TakeArm"),
        (35, 36, 37, 38),
        (
            "After the error of slvMove 18 your client made 2 more calls that can change or move something",
            "from Motor 19 on",
            "shows no later ClearError of this client",
        ),
        _after_error("ClearError", "Motor"),
        "underflow",
    ),
    Scene(
        "cleared-unread",
        _after_error("ClearError"),
        (35, 36, 37, 38),
        (
            "called ClearError at 0.210 s",
            "no earlier call that read the details of error 0x84201482",
        ),
        _after_error("GetCurErrorCount", "ClearError"),
        "underflow",
    ),
    Scene(
        "controller-timeout",
        _refuses(0x80000900),
        (9, 10),
        ("ExtSpeed 5", "E_TIMEOUT 0x80000900"),
        _refuses(0),
    ),
    Scene("robot-busy", _refuses(0x80010004), (9, 10), ("ExtSpeed 5", "robot is busy"), _refuses(0)),
    Scene("controller-error", _refuses(0x84999999), (9, 10), ("ExtSpeed 5", "0x84999999", "level 4"), good),
)
