"""Whether the controller is still there."""

from __future__ import annotations

from bcapscope.client.target import Target
from bcapscope.tui.desk.arming import Arming
from bcapscope.tui.desk.halt import HaltNews, HaltState
from bcapscope.tui.desk.news import Status
from bcapscope.tui.desk.pulse import PATIENCE, Pulse
from bcapscope.tui.tester.status import status_text

SECOND = 1_000_000_000


def test_a_silence_counts_from_the_first_request_on() -> None:
    pulse = Pulse(0)
    assert not pulse.is_silent(3600 * SECOND)
    pulse.asked(3600 * SECOND)
    pulse.asked(3600 * SECOND + PATIENCE)
    assert not pulse.is_silent(3600 * SECOND + PATIENCE)
    assert pulse.is_silent(3600 * SECOND + PATIENCE + 1)
    pulse.heard(3700 * SECOND)
    assert not pulse.is_silent(3900 * SECOND)
    assert pulse.age(3702 * SECOND) == 2 * SECOND


def test_a_controller_that_nobody_asks_is_not_said_to_be_gone() -> None:
    """In slave mode nothing is asked, so that only the age of what is known is shown."""
    pulse, status = Pulse(0), Status(Target("10.0.0.1", 5007), round_trip=1_000_000)

    def line(now: int) -> list[tuple[str, str]]:
        return status_text(status, Arming(), now, HaltNews(HaltState.READY), pulse)[:2]

    assert line(2 * SECOND) == [(" ● 10.0.0.1 ", "good"), ("1.0 ms ", "dim")]
    assert line(7 * SECOND) == [(" ● 10.0.0.1 ", ""), ("answered 7 s ago ", "dim")]
    pulse.asked(SECOND)
    assert line(7 * SECOND) == [(" ◌ 10.0.0.1 ", "bad"), ("no answer for 7 s ", "bad")]
