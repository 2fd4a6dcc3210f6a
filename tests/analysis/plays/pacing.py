"""Set points that come too late, too fast, or out of step."""

from __future__ import annotations

from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import HOME, ROBOT, Play, Story, good
from tests.samples.calls import r8s, text
from tests.samples.tcp import Connection

_EMPTY, _OVERFLOW, _FULL, _NOT_IN = 0x84201482, 0x83201483, 0x0F200501, 0x83500121
_RC7 = "CaoProv.DENSO.NetwoRC"


def _pause(
    length: float,
    code: int = 0,
    mode: int = 0x202,
    moving: bool = True,
    provider: str = "CaoProv.DENSO.VRC",
) -> Play:
    """A client that sends nothing for `length` ms in the middle of its motion."""

    def play(story: Story) -> None:
        client = story.client()
        client.open(provider=provider)
        client.ready()
        client.enter(40, mode)
        client.move(50, 10, step=0.05 if moving else 0.0)
        at = 122 + length
        client.point(at, 0.5 if moving else 0.0, code)
        if code:
            client.point(at + 8, 0.55, _NOT_IN)
        else:
            client.leave(client.move(at + 8, 10, first=0.55 if moving else 0.0, step=0.05 if moving else 0.0))

    return play


def _waits_for_reply(story: Story) -> None:
    """The reply comes 19 ms after the set point, the client had given up at 16 ms; the buffer ran empty."""
    client = story.client()
    client.drive(10)
    pose = r8s(0.5, *HOME[1:])
    first = client.ask(130, "Robot_Execute", ROBOT, text("slvMove"), pose, serial=4711)
    again = client.ask(146, "Robot_Execute", ROBOT, text("slvMove"), pose, reserved=first)
    client.answer(149, first, pose)
    client.answer(150, again, pose)
    client.point(157, 0.55, _EMPTY, takes=0.4)
    client.point(165, 0.6, _NOT_IN)


def _reply_not_captured(story: Story) -> None:
    """The capture lacks the reply to the set point before a pause."""
    client = story.client(tcp=True)
    client.drive(10)
    client.ask(130, "Robot_Execute", ROBOT, text("slvMove"), r8s(0.5, *HOME[1:]))
    assert isinstance(client.network, Connection)
    client.network.down_unseen(40)
    client.point(194, 0.55, _EMPTY, takes=0.4)
    client.point(202, 0.6, _NOT_IN)


def _cycle(every: float, mode: int, points: int = 80, takes: float = 0.7, step: float = 0.01) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.enter(40, mode)
        for index in range(points):
            client.point(50 + index * every, index * step, takes=takes)
        client.leave(50 + points * every)

    return play


def _skips(mode: int) -> Play:
    """A client that is one period late with every fourth set point."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.enter(40, mode)
        for index in range(80):
            client.point(50 + index * 8 + index // 4 * 8, index * 0.01)
        client.leave(50 + 100 * 8)

    return play


def _in_unknown_mode(every: float) -> Play:
    """A capture that begins and ends in the middle of slave mode."""

    def play(story: Story) -> None:
        story.client().move(0, 80, every, step=0.01)

    return play


def _too_fast(story: Story) -> None:
    client = story.client()
    client.open()
    client.ready()
    client.enter(40, 0x002)
    for index in range(5):
        client.point(50 + index * 2, index * 0.01, _FULL if index > 2 else 0)
    client.point(60, 0.05, _OVERFLOW)
    client.point(68, 0.05)
    client.leave(76)


SCENES = (
    Scene(
        "set-point-gap",
        _pause(64, _EMPTY),
        (33, 34, 35, 36),
        (
            "After slvMove 17 at 0.122 s, your client sent no set point for 64 ms. The buffer lasts 24 ms.",
            "The reply arrived after 0.7 ms, and the next set point was sent 63 ms later.",
            "0.7 ms later, the controller reported that it had run out of set points",
            "Everything after that is a consequence",
        ),
        _pause(10),
    ),
    Scene("set-point-gap", _pause(64), (33, 35), ("by a model of the buffer",), _pause(64, moving=False)),
    Scene("set-point-gap", _pause(64), (33, 35), ("while the robot moved",), _pause(64, mode=0x102)),
    Scene(
        "set-point-gap",
        _waits_for_reply,
        (33, 35, 36, 37, 38, 39, 40),
        ("slvMove 4711", "for 27 ms"),
        good,
        "late-reply",
    ),
    Scene(
        "set-point-gap",
        _reply_not_captured,
        (35, 36, 38),
        ("sent no set point for 64 ms. The buffer lasts 24 ms. The reply was not captured.",),
        good,
    ),
    Scene(
        "underflow",
        _pause(64, _EMPTY),
        (33, 34, 35, 36),
        ("the reply to slvMove 18", "0x84201482", "No set point was sent for 64 ms after slvMove 17"),
        _pause(64),
        "set-point-gap",
    ),
    Scene(
        "set-point-gap",
        _pause(20, _EMPTY, 0x002, provider=_RC7),
        (33, 34, 35, 36),
        ("sent no set point for 20 ms. The buffer lasts 16 ms.",),
        _pause(10, _EMPTY, 0x002, provider=_RC7),
    ),
    Scene(
        "underflow",
        _pause(10, _EMPTY, 0x002, provider=_RC7),
        (35, 36),
        ("The last set points before that were at most 16 ms apart",),
        _pause(20, mode=0x002, provider=_RC7),
    ),
    Scene(
        "overflow",
        _too_fast,
        (25, 26),
        ("slvMove 13 of your client was refused with 0x83201483", "came every 2.0 ms", "a full buffer"),
        _cycle(8, 0x002),
    ),
    Scene(
        "off-grid",
        _cycle(3.2, 0x002),
        (15, 173),
        ("78 set points every 3.2 ms", "312 per second", "8 ms"),
        _cycle(8, 0x002),
    ),
    Scene("off-grid", _cycle(10, 0x202), (15, 173), ("78 set points every 10 ms",), _cycle(8.2, 0x202)),
    Scene(
        "off-grid",
        _cycle(9.2, 0x202, takes=8.8),
        (15, 173),
        (
            "78 set points every 9.2 ms",
            "as soon as the reply to the previous one arrived, so the replies set this pace",
        ),
        _cycle(8.2, 0x202, takes=7.8),
    ),
    Scene(
        "off-grid", _skips(0x202), (15, 173), ("19 of 78 cycles took one and a half periods",), _skips(0x102)
    ),
    Scene(
        "slow-set-points",
        _cycle(16, 0x102),
        (15, 173),
        ("78 set points every 16 ms", "the controller holds the last set point"),
        _cycle(8, 0x102),
    ),
    Scene(
        "slow-set-points",
        _cycle(32, 0x102, takes=31.5),
        (15, 173),
        ("78 set points every 32 ms",),
        _cycle(32, 0x102, step=0.0),
    ),
    Scene(
        "slow-set-points",
        _skips(0x102),
        (15, 173),
        ("19 of 78 cycles took one and a half periods",),
        _skips(0x202),
    ),
    Scene(
        "slow-set-points",
        _in_unknown_mode(16),
        (1, 159),
        ("78 set points every 16 ms", "The capture does not show the mode."),
        _in_unknown_mode(8),
    ),
    Scene(
        "replies-do-not-pace", _cycle(2, 0x202), (15, 173), ("78 set points every 2 ms",), _cycle(8, 0x202)
    ),
)
