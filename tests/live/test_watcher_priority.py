"""The watcher gives way while it keeps up, and gets its share when it does not."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from bcapscope.live.watcher_priority import (
    IDLE_AGAIN_AFTER,
    LATE_AFTER,
    MAX_RING_SHARE,
    OVERDUE_AFTER,
    WatcherPriority,
    WatcherUrgency,
    _can_leave_idle_priority,
    idle_priority_switch,
    yield_function,
)
from bcapscope.proxy.ring_buffer import RING_OVERHEAD, RingReader, RingWriter

SIZE = 1 << 14
POLICIES = pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="Linux has idle priority")


class Scene:
    """A ring with a recorder and a decoder, and what was asked of the watcher."""

    def __init__(self) -> None:
        memory = memoryview(bytearray(RING_OVERHEAD + SIZE))
        self.writer = RingWriter(memory)
        self.recorder, self.decoder = RingReader(memory, ahead=True), RingReader(memory)
        self.asked: list[bool] = []
        self.now = 0.0
        self.courtesy = WatcherPriority(self.writer, self.asked.append)

    def pass_for(self, seconds: float, *, recorded: bool = True, decoded: bool = True) -> None:
        for _ in range(round(seconds / 0.05)):
            self.writer.write_record(True, 1, 2, 3, b"\x01")
            if recorded:
                self.recorder.read_records()
            if decoded:
                self.decoder.read_records()
            self.now += 0.05
            self.courtesy.update(self.now)


def test_it_gives_way_while_it_keeps_up() -> None:
    scene = Scene()
    scene.pass_for(100)
    assert scene.asked == [True]


def test_what_is_not_recorded_in_time_ends_it_and_time_without_delay_brings_it_back() -> None:
    scene = Scene()
    scene.pass_for(2)
    scene.pass_for(2 * LATE_AFTER, recorded=False, decoded=False)
    assert scene.asked == [True, False]
    assert scene.recorder.urgency == WatcherUrgency.SOME
    scene.pass_for(IDLE_AGAIN_AFTER - 1)
    assert scene.asked == [True, False]
    scene.pass_for(2)
    assert scene.asked == [True, False, True]
    assert scene.recorder.urgency == WatcherUrgency.NONE


def test_what_is_overdue_gives_others_no_turn_until_there_is_time_again() -> None:
    scene = Scene()
    scene.pass_for(2)
    scene.pass_for(OVERDUE_AFTER + 0.2, recorded=False, decoded=False)
    assert scene.decoder.urgency == WatcherUrgency.ALL
    scene.pass_for(LATE_AFTER + 0.2, recorded=False, decoded=False)
    scene.pass_for(IDLE_AGAIN_AFTER - 1)
    assert scene.decoder.urgency == WatcherUrgency.ALL
    scene.pass_for(2)
    assert scene.decoder.urgency == WatcherUrgency.NONE
    assert scene.asked == [True, False, True]


@pytest.mark.skipif(not hasattr(os, "sched_yield"), reason="there is nothing to yield with")
def test_others_have_their_turn_but_not_when_all_haste_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, yields = Scene(), []
    monkeypatch.setattr(os, "sched_yield", lambda: yields.append(scene.now))
    give = yield_function(scene.decoder)
    for haste, count in ((WatcherUrgency.NONE, 1), (WatcherUrgency.SOME, 2), (WatcherUrgency.ALL, 2)):
        scene.writer.urgency = haste
        give()
        assert len(yields) == count


def test_what_is_recorded_may_be_decoded_later_until_half_the_ring_waits() -> None:
    scene = Scene()
    while scene.writer.fill_ratio < MAX_RING_SHARE - 0.01:
        scene.pass_for(0.05, decoded=False)
    assert scene.now > 3 * LATE_AFTER
    assert scene.asked == [True]
    scene.pass_for(1, decoded=False)
    assert scene.asked == [True, False]


def test_without_a_recording_the_decoder_counts() -> None:
    scene = Scene()
    scene.pass_for(2, recorded=False)
    assert scene.asked == [True]
    scene.pass_for(1, recorded=False, decoded=False)
    assert scene.asked == [True, False]


def test_silence_is_no_delay() -> None:
    scene = Scene()
    scene.pass_for(1)
    scene.recorder.read_records()  # what was there at its last look
    scene.courtesy.update(scene.now + 1000)
    scene.courtesy.update(scene.now + 2000)
    assert scene.asked == [True]


def test_at_the_end_it_gives_way_no_more() -> None:
    scene = Scene()
    scene.pass_for(1)
    for _ in range(2):
        scene.courtesy.raise_for_good()
        scene.pass_for(IDLE_AGAIN_AFTER + 1)
        assert scene.asked == [True, False]
        assert scene.decoder.urgency == WatcherUrgency.ALL


@POLICIES
def test_a_process_gets_idle_priority_only_if_it_can_come_back() -> None:
    program = "import os; os.nice(3); print(flush=True); input()"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", program], stdin=pipe, stdout=pipe) as process:
        assert process.stdout is not None
        process.stdout.readline()
        give = idle_priority_switch(process.pid)
        before = os.sched_getscheduler(process.pid)
        give(True)
        expected = os.SCHED_IDLE if _can_leave_idle_priority() else before
        assert os.sched_getscheduler(process.pid) == expected
        give(False)
        assert os.sched_getscheduler(process.pid) in {before, os.SCHED_OTHER}
        if os.geteuid() == 0:
            nice = [os.getpriority(os.PRIO_PROCESS, each) for each in (0, process.pid)]
            assert nice[0] == nice[1]
        process.communicate(b"\n")
    give(True)
    assert os.sched_getscheduler(0) != os.SCHED_IDLE
