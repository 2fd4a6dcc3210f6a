"""What changes a motion while it runs."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import ROBOT, Play, Story
from tests.samples.calls import i4, r8s, text


def _other_client_sets_speed(ms: float) -> Play:
    """One client moves from 50 to 450 ms; another one sets the external speed."""

    def play(story: Story) -> None:
        mover, other = story.client(50001), story.client(50002)
        mover.open()
        mover.ready()
        mover.call(50, "Robot_Move", ROBOT, i4(1), text("P(1,2,3)"), text(""), takes=400)
        mover.close(600)
        other.open(1)
        other.execute(ms, "ExtSpeed", r8s(50.0))
        other.close(620)

    return play


def _variable_in_slave_mode(ms: float) -> Play:
    """One client sends set points from 50 to 450 ms; another one writes @EXTSPEED."""

    def play(story: Story) -> None:
        mover, other = story.client(50001), story.client(50002)
        mover.leave(mover.drive(50))
        other.open(1)
        other.call(21, "Robot_GetVariable", ROBOT, text("@EXTSPEED"), text(""), result=i4(10))
        other.call(ms, "Variable_PutValue", i4(10), i4(30), result=EMPTY)
        other.call(700, "Variable_Release", i4(10))
        other.close(710)

    return play


SCENES = (
    Scene(
        "speed-changed-in-motion",
        _other_client_sets_speed(200),
        (21, 22, 23, 24),
        (
            "At 0.201 s client 192.168.0.10:50002 (UDP) changed the external speed with ExtSpeed",
            "Robot_Move 7",
        ),
        _other_client_sets_speed(500),
    ),
    Scene(
        "speed-changed-in-motion",
        _variable_in_slave_mode(200),
        (25, 63, 64, 125),
        ("with Variable_PutValue", "while slvMove of client 192.168.0.10:50001 (UDP) ran"),
        _variable_in_slave_mode(600),
    ),
)
