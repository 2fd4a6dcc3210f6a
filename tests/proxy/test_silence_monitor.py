"""Silence in slave mode is told once, and its end."""

from __future__ import annotations

from bcapscope.proxy.silence_monitor import SILENT_AFTER_NS, SilenceMonitor
from tests.faults.traffic import talk

CLIENT = talk().up.conversation
SECOND = 1_000_000_000


def test_a_silence_and_its_end_are_told_once() -> None:
    monitor = SilenceMonitor()
    assert list(monitor.check([(CLIENT, 0)], SILENT_AFTER_NS)) == []
    assert list(map(str, monitor.check([(CLIENT, 0)], SILENT_AFTER_NS + 1))) == [
        "10.0.0.2:50001 has sent nothing for 0.5 s while slave mode is on"
    ]
    assert list(monitor.check([(CLIENT, 0)], 2 * SECOND)) == []
    assert list(map(str, monitor.check([(CLIENT, 3 * SECOND)], 3 * SECOND))) == [
        "10.0.0.2:50001 sends again, after 3.0 s of silence"
    ]
    assert list(monitor.check([(CLIENT, 3 * SECOND)], 3 * SECOND + 1)) == []


def test_who_has_left_slave_mode_or_is_gone_is_forgotten() -> None:
    monitor = SilenceMonitor()
    assert list(monitor.check([(CLIENT, 0)], SECOND))
    assert list(monitor.check([], SECOND)) == []
    assert list(monitor.check([(CLIENT, 0)], SECOND))
