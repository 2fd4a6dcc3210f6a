"""Whether the controller is still there."""

from __future__ import annotations

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.live.controller.arming_state import ArmingState
from bcapscope.live.controller.halt_connection import HaltState, HaltUpdate
from bcapscope.live.controller.reply_monitor import REPLY_OVERDUE_AFTER, ReplyMonitor
from bcapscope.live.controller.session_updates import SessionStatus
from bcapscope.tui.tester.connection_panel import status_pieces

SECOND = 1_000_000_000


def test_a_silence_counts_from_the_first_request_on() -> None:
    pulse = ReplyMonitor(0)
    assert not pulse.is_reply_overdue(3600 * SECOND)
    pulse.on_request(3600 * SECOND)
    pulse.on_request(3600 * SECOND + REPLY_OVERDUE_AFTER)
    assert not pulse.is_reply_overdue(3600 * SECOND + REPLY_OVERDUE_AFTER)
    assert pulse.is_reply_overdue(3600 * SECOND + REPLY_OVERDUE_AFTER + 1)
    pulse.on_received(3700 * SECOND)
    assert not pulse.is_reply_overdue(3900 * SECOND)
    assert pulse.silence(3702 * SECOND) == 2 * SECOND


def test_a_controller_that_nobody_asks_is_not_said_to_be_gone() -> None:
    """In slave mode nothing is asked, so that only the age of what is known is shown."""
    pulse, status = ReplyMonitor(0), SessionStatus(ControllerTarget("10.0.0.1", 5007), round_trip=1_000_000)

    def line(now: int) -> list[tuple[str, str]]:
        return status_pieces(status, ArmingState(), now, HaltUpdate(HaltState.READY), pulse)[:2]

    assert line(2 * SECOND) == [(" ● 10.0.0.1 ", "good"), ("1.0 ms ", "dim")]
    assert line(7 * SECOND) == [(" ● 10.0.0.1 ", ""), ("answered 7 s ago ", "dim")]
    pulse.on_request(SECOND)
    assert line(7 * SECOND) == [(" ◌ 10.0.0.1 ", "bad"), ("no answer for 7 s ", "bad")]
