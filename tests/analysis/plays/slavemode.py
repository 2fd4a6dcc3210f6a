"""Slave mode entered wrongly, left unawares, or disturbed by another client."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import CONTROLLER, Play, Story, Talker, good
from tests.samples.calls import i4, r8s, text

_NOT_IN, _REFUSED, _INVALID = 0x83500121, 0x83501032, 0x80070057


def _in_slave_mode(story: Story, points: int = 10) -> Talker:
    client = story.client()
    client.drive(points)
    return client


def _moves_at_once(story: Story) -> None:
    client = story.client()
    client.open()
    client.ready()
    client.point(50, 0.0, _NOT_IN)


def _moves_after_leaving(story: Story) -> None:
    client = _in_slave_mode(story)
    client.execute(130, "slvChangeMode", i4(0))
    client.point(138, 0.5, _NOT_IN)


def _second_client(runs: str, code: int = 0, at: float = 120) -> Play:
    """Client B runs a command while client A is in slave mode, and A's next set point is refused."""

    def play(story: Story) -> None:
        first = _in_slave_mode(story, 20)
        second = story.client(50002)
        second.call(0, "Service_Start", text(",WDT=400"))
        second.call(at, "Controller_Execute", CONTROLLER, text(runs), r8s(30.0, 50.0), code=code)
        first.point(210, 1.0, _NOT_IN)
        first.point(218, 1.05, _NOT_IN)
        for number in range(30):
            second.call(
                200 + 10 * number, "Controller_Execute", CONTROLLER, text("SysState"), EMPTY, result=i4(4)
            )
        second.call(600, "Service_Stop")

    return play


def _refused_at_home(story: Story) -> None:
    client = _in_slave_mode(story)
    client.execute(130, "TakeArm", code=_REFUSED)
    client.point(138, 0.5, _NOT_IN)


def _switched_by_other(asks_for: int) -> Play:
    def play(story: Story) -> None:
        first = _in_slave_mode(story, 20)
        second = story.client(50002)
        second.open(60)
        second.execute(205, "slvChangeMode" if not asks_for else "slvGetMode", i4(asks_for))
        second.close(300)
        first.point(210, 1.0, 0 if asks_for else _NOT_IN)
        first.leave(220)

    return play


def _mode(value: int, code: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.execute(40, "slvChangeMode", i4(value), code=code)
        client.execute(50, "slvChangeMode", i4(0))
        client.close(60)

    return play


SCENES = (
    Scene(
        "slvmove-outside-slave-mode",
        _moves_at_once,
        (13, 14),
        (
            "slvMove 7 of your client was refused with 0x83500121",
            "the capture shows no slvChangeMode of this client that switched slave mode on",
        ),
        good,
    ),
    Scene(
        "slvmove-outside-slave-mode",
        _moves_after_leaving,
        (35, 36, 37, 38),
        ("slvChangeMode 18 of the same client had left slave mode at 0.130 s",),
        good,
    ),
    Scene(
        "slvmove-outside-slave-mode",
        _second_client("HandMoveA", _REFUSED),
        (61, 63, 66),
        ("no captured call of this client switched it off",),
        good,
        "refused-in-slave-mode",
    ),
    Scene(
        "refused-in-slave-mode",
        _second_client("HandMoveA", _REFUSED),
        (35, 36),
        (
            "Client 192.168.0.10:50002 (UDP) called HandMoveA at 0.120 s",
            "while client 192.168.0.10:50001 (UDP) was in slave mode",
            "(0x83501032)",
            "90 ms later, slvMove was refused (0x83500121",
            "Everything after that is a consequence",
        ),
        _second_client("SysState"),
    ),
    Scene(
        "refused-in-slave-mode", _refused_at_home, (35, 36), ("called TakeArm", "in slave mode itself"), good
    ),
    Scene(
        "slave-mode-ended-by-other",
        _switched_by_other(0),
        (63, 64),
        ("Client 192.168.0.10:50002 called slvChangeMode at 0.205 s while client 192.168.0.10:50001 (UDP)",),
        _switched_by_other(1),
    ),
    Scene(
        "slave-mode-lost-unseen",
        _second_client("HandMoveA", at=205),
        (57, 59, 63),
        (
            "Slave mode of client 192.168.0.10:50001 (UDP) was off",
            "HandMoveA at 0.205 s, which may be the reason",
        ),
        good,
    ),
    Scene("slave-mode-refused", _mode(0x204, _INVALID), (13, 14), ("the mode is 0x204",), _mode(0x202, 0)),
)
