"""Reading value by value."""

from __future__ import annotations

from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import CONTROLLER, Play, Story
from tests.samples.calls import i4, text


def _reads(times: int, takes: float = 1.7) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.call(50, "Controller_GetVariable", CONTROLLER, text("IO128"), text(""), result=i4(10))
        for number in range(times):
            client.call(60 + 2 * number, "Variable_GetValue", i4(10), result=i4(1), takes=takes)
        client.call(70 + 2 * times, "Variable_Release", i4(10))
        client.close(80 + 2 * times)

    return play


SCENES = (
    Scene(
        "polling",
        _reads(300),
        (11, 609),
        (
            "300 of 309 calls of your client read a single variable, mostly 'IO128' (300)",
            "Each read took 1.7 ms, and all reads together 85% of the time",
        ),
        _reads(20),
    ),
    Scene(
        "polling",
        _reads(200, takes=2.0),
        (11, 409),
        ("2.0 ms, and all reads together 100% of the time",),
        _reads(20),
    ),
)
