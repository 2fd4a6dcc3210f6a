"""Whether the controller is still there."""

from __future__ import annotations

from dataclasses import replace

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

    def line(status: Status) -> str:
        halt = HaltNews(HaltState.READY)
        return "".join(text for text, _ in status_text(status, Arming(), 7 * SECOND, halt, pulse))

    assert "● 10.0.0.1 1.0 ms" in line(status)
    in_slave_mode = replace(status, slave_mode=0x202)
    assert "● 10.0.0.1 answered 7 s ago" in line(in_slave_mode)
    pulse.asked(SECOND)
    assert "◌ 10.0.0.1 no answer for 7 s" in line(in_slave_mode)
