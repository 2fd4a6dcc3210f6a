"""Set points that ask too much of an axis, or begin somewhere else than the robot is."""

from __future__ import annotations

import math

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import HOME, Play, Story, good
from tests.samples.calls import r8s

_TOO_FAST, _BEYOND, _INVALID = 0x84204043, 0x83204071, 0x83201405


def _ends_with(point: tuple[float, ...], code: int) -> Play:
    """A smooth motion, then one set point of its own and its result."""

    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(10)
        client.execute(at, "slvMove", r8s(*point), EMPTY if code else r8s(*point), code=code)
        if not code:
            client.leave(client.move(at + 8, 10, first=point[0] + 0.05))

    return play


def _begins_at(first: float, known: float = 0.0) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.execute(30, "CurJnt", result=r8s(known, *HOME[1:]))
        client.enter(40)
        client.execute(50, "slvMove", r8s(first, *HOME[1:]), r8s(known, *HOME[1:]))
        client.leave(client.move(58, 20, first=first + 0.05))

    return play


def _strays(*points: float) -> Play:
    """A smooth motion with a few set points of its own in it, and on from where it was."""

    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(10)
        for number, first in enumerate(points):
            client.execute(at + 8 * number, "slvMove", r8s(first, *HOME[1:]), r8s(0.5, *HOME[1:]))
        client.leave(client.move(at + 8 * len(points), 10, first=0.5))

    return play


SCENES = (
    Scene(
        "over-limit",
        _ends_with((0.5, 10.0, 83.5, 0.0, 90.0, 0.0, 0.0, 0.0), _TOO_FAST),
        (35, 36),
        (
            "0x84204043, J3: commanded acceleration too high",
            "the largest step of J3 in the 11 set points up to then is 3.5 deg, from slvMove 17 to "
            "slvMove 18",
            "438 deg/s",
        ),
        _ends_with((0.5, *HOME[1:]), 0),
    ),
    Scene(
        "beyond-range",
        _ends_with((170.5, *HOME[1:]), _BEYOND),
        (35, 36),
        ("0x83204071", "the set point commands J1 = 170.5"),
        good,
    ),
    Scene(
        "invalid-set-point",
        _ends_with(HOME[:5], _INVALID),
        (35, 36),
        ("0x83201405", "5 numbers for a pose of type J"),
        good,
    ),
    Scene(
        "not-finite",
        _ends_with((math.nan, *HOME[1:]), _INVALID),
        (35,),
        ("1 set point with a NaN", "frame 35"),
        good,
    ),
    Scene(
        "far-first-point",
        _begins_at(12.0),
        (17, 18),
        ("The first set point of your client is 12 deg away in J1", "the reply to the first set point"),
        _begins_at(0.2),
    ),
    Scene(
        "set-point-jump",
        _ends_with((9.0, *HOME[1:]), 0),
        (35,),
        ("the set point of frame 35 jumps by 8.55 deg in J1", "1069 deg/s", "far more than those around it"),
        _ends_with((0.5, *HOME[1:]), 0),
    ),
    Scene(
        "set-point-jump",
        _strays(9.0),
        (35,),
        ("frame 35 jumps by 8.55 deg in J1", "far more than those around it. The next one turns back."),
        _strays(0.55),
    ),
    Scene(
        "set-point-jump",
        _strays(1e200),
        (35, 37),
        ("frame 35 jumps by 1e+200 deg in J1", "more than any axis can follow. This happened twice"),
        _strays(0.55),
    ),
    Scene(
        "set-point-jump",
        _ends_with((1e200, *HOME[1:]), _INVALID),
        (35,),
        ("frame 35 jumps by 1e+200 deg in J1", "more than any axis can follow"),
        _ends_with((0.5, *HOME[1:]), 0),
    ),
)
