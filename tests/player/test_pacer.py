"""Deadlines, and who sets them, by a clock that jumps; `test_visit` has the rest of it."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest

from bcapscope.errors import CallTimeout, ControllerError
from bcapscope.player.arm_limits import UNKNOWN_ARM
from bcapscope.player.blocking_caller import BlockingCaller, Channel
from bcapscope.player.pacer import MIN_PERIOD_SHARE, HaltedError, IdleCallback, Pacer, SlvMoveCall
from bcapscope.player.player_messages import SetPointValues
from bcapscope.player.set_point_sequence import SetPointSequence
from bcapscope.player.trajectory import Trajectory, TrajectorySource
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.retry.requester import CallAnswered, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, SlaveMode, slave_mode_by_number
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL, S_OK

MS = 1_000_000
POINTS = 40


class Controller(Channel):
    """A channel to a controller that answers as a script says.

    Attributes:
        sent: when each set point was sent.
        codes: result of each, S_OK after the last.
        takes: ns until each is answered; None for those that are not.
        oversleeps: ns that the wait for each takes too long.
        rests: ns that resting after each takes too long.
        naps: ns that the first wait for a reply to each takes, whatever was wanted.
        stops: likewise, and what came meanwhile is there then.
        arrival_time: when the last reply came.
        looks: when something was looked for.
    """

    datagrams = True
    local = ("127.0.0.1", 1)
    peer = ("127.0.0.1", 5007)

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.points: list[float] = []
        self.codes: dict[int, int] = {}
        self.takes: dict[int, int | None] = {}
        self.oversleeps: dict[int, int] = {}
        self.rests: dict[int, int] = {}
        self.naps: dict[int, int] = {}
        self.stops: dict[int, int] = {}
        self.arrival_time = 0
        self.looks: list[int] = []
        self._now = 0
        self._replies: list[tuple[int, bytes]] = []

    def now(self) -> int:
        return self._now

    def wait_until(self, until: int) -> None:
        self._now = max(self._now, until + self.oversleeps.get(len(self.sent), 0))

    def sleep_until(self, until: int) -> None:
        self._now = max(self._now, until + self.rests.get(len(self.sent) - 1, 0))

    def send(self, data: bytes) -> None:
        number, frame = len(self.sent), Frame(data)
        self.sent.append(self._now)
        row = frame.arguments[2].variant.value
        assert isinstance(row, tuple)
        assert isinstance(row[0], float)
        self.points.append(row[0])
        reply = encode_frame(frame.serial, 0, self.codes.get(number, S_OK), ())
        takes = self.takes.get(number, MS // 10)
        if takes is not None:
            self._replies.append((self._now + takes, reply))

    def receive(self, until: int) -> bytes | None:
        self.looks.append(self._now)
        nap = self.naps.pop(len(self.sent) - 1, 0)
        if nap:
            self._now += nap
            return None
        self._now += self.stops.pop(len(self.sent) - 1, 0)
        due = self._replies[0][0] if self._replies else until + 1
        self._now = max(self._now, min(due, until))
        if due > self._now:
            return None
        self.arrival_time, reply = self._replies.pop(0)
        return reply

    def close(self) -> None:
        raise AssertionError


def mode(value: int, generation: Generation = Generation.RC8) -> SlaveMode:
    """Return a mode."""
    found = slave_mode_by_number(value, generation)
    assert found is not None
    return found


def play(
    controller: Controller,
    chosen: SlaveMode,
    hold: int = 0,
    period: int = 8 * MS,
    idle: IdleCallback = lambda _: None,
) -> Pacer:
    """Play points that are numbered from 0."""
    rows = np.zeros((POINTS, 8))
    rows[:, 0] = np.arange(POINTS)
    course = SetPointSequence(Trajectory(PoseType.J, rows, TrajectorySource("")), 0.008, UNKNOWN_ARM, 1, hold)
    pace = (
        RetryPolicy(2 * MS, 0 if chosen.overwrites_waiting else 7)
        if controller.datagrams
        else RetryPolicy(5000 * MS, 0)
    )
    exchanger = BlockingCaller(
        controller, ReservedConvention.SEED if controller.datagrams else ReservedConvention.TCP0
    )
    pacer = Pacer(exchanger, SlvMoveCall(1, VT.R8, chosen, pace, period), course, idle, 100)
    pacer.play()
    return pacer


def gaps(controller: Controller) -> list[float]:
    """Return ms between set points."""
    return [(b - a) / MS for a, b in pairwise(controller.sent)]


def test_a_little_late_keeps_the_grid() -> None:
    controller = Controller()
    controller.oversleeps = {10: 3 * MS}
    pacer = play(controller, mode(0x102))
    assert gaps(controller)[8:12] == [8, 11, 5, 8]
    assert (pacer.lateness.exact_spread().most, pacer.counts.shifted) == (3 * MS, 0)


def test_much_too_late_moves_the_grid_and_leaves_no_point_out() -> None:
    controller = Controller()
    controller.oversleeps = {10: 30 * MS}
    pacer = play(controller, mode(0x102))
    assert gaps(controller)[8:12] == [8, 38, 8, 8]
    assert pacer.counts.shifted == 1
    assert controller.points == list(range(POINTS))


def test_being_held_up_is_no_silence_of_the_controller() -> None:
    controller = Controller()
    controller.oversleeps = {10: 500 * MS}
    assert play(controller, mode(0x102)).counts.unanswered == 0


def test_what_is_under_way_is_not_unanswered() -> None:
    seen: list[int] = []
    exchanger = BlockingCaller(Controller(), ReservedConvention.SEED)
    course = SetPointSequence(
        Trajectory(PoseType.J, np.zeros((3, 8)), TrajectorySource("")), 0.008, UNKNOWN_ARM, 1, 0
    )
    move = SlvMoveCall(1, VT.R8, mode(0x002), RetryPolicy(2 * MS, 7), 8 * MS)
    pacer = Pacer(exchanger, move, course, lambda _: seen.append(pacer.counts.unanswered), 100)
    pacer.play()
    assert pacer.counts.sent >= 3
    assert set(seen) == {0}


def test_a_late_reply_delays_nothing_in_async() -> None:
    controller = Controller()
    controller.takes = {10: 9 * MS}
    pacer = play(controller, mode(0x102))
    assert set(gaps(controller)) == {8}
    assert (pacer.counts.late, pacer.counts.unanswered, pacer.counts.retries) == (1, 0, 0)


@pytest.mark.parametrize(
    ("datagrams", "period", "looks"),
    [
        pytest.param(True, MS, 0.5, id="udp 1 ms"),
        pytest.param(True, 8 * MS, 1.9, id="udp 8 ms"),
        pytest.param(False, 8 * MS, 6.9, id="tcp 8 ms"),
    ],
)
def test_no_reply_wakes_us_where_we_set_the_pace(datagrams: bool, period: int, looks: float) -> None:
    controller = Controller()
    controller.datagrams = datagrams
    pacer = play(controller, mode(0x102), period=period)
    looked = [when - sent for when, sent in zip(controller.looks, controller.sent, strict=True)]
    assert looked == [looks * MS] * POINTS  # shortly before the next is prepared, or the call given up
    assert (pacer.counts.late, pacer.counts.unanswered) == (0, 0)
    assert {gap * MS for gap in gaps(controller)} == {period}


@pytest.mark.parametrize("value", [0x002, 0x202])
def test_a_reply_is_awaited_where_the_controller_sets_the_pace(value: int) -> None:
    controller = Controller()
    play(controller, mode(value))
    assert controller.looks == controller.sent


def test_who_has_replies_to_catch_up_with_reads_them_at_once() -> None:
    controller = Controller()
    controller.takes = {10: 9 * MS}
    play(controller, mode(0x102))
    at_once = [number for number, sent in enumerate(controller.sent) if sent in controller.looks]
    assert at_once == [11, 12]  # after the one that was given up, and the one with which its reply came


@pytest.mark.parametrize("period", [8, 10, 17, 20, 23, 100, 1000])
@pytest.mark.parametrize(
    "takes", [pytest.param(MS // 10, id="answered"), pytest.param(None, id="unanswered")]
)
def test_orders_are_looked_for_all_the_time(period: int, takes: int | None) -> None:
    controller = Controller()
    controller.datagrams = False
    controller.takes = dict.fromkeys(range(1, 5), takes)
    looked: list[int] = []
    with suppress(CallTimeout):  # long periods without an answer
        play(controller, mode(0x102), idle=looked.append, period=period * MS)
    assert max(b - a for a, b in pairwise(looked)) <= 16 * MS


def test_a_reply_that_was_slept_through_has_the_time_at_which_it_came() -> None:
    controller, heard = Controller(), []
    controller.rests = {0: 3 * MS}

    def watch(sent: bool, raw: bytes, time: int) -> None:
        heard.append((sent, time))

    exchanger = BlockingCaller(controller, ReservedConvention.SEED, watch)
    move = SlvMoveCall(1, VT.R8, mode(0x102), RetryPolicy(100 * MS, 0), 8 * MS)
    exchanger.begin_call(64, move.arguments((1.0,) * 8), move.retry_policy, 0)
    exchanger.send_due()
    exchanger.sleep_until_due(5 * MS)
    settled = exchanger.wait_for_outcome(10 * MS)
    assert isinstance(settled, CallAnswered)
    assert settled.elapsed == MS // 10
    assert heard == [(True, 0), (False, MS // 10)]
    assert (exchanger.link.now(), exchanger.overslept) == (7.9 * MS, 3 * MS)


def test_a_rest_that_takes_too_long_is_our_lateness() -> None:
    controller = Controller()
    controller.rests = {10: 40 * MS}
    controller.codes = {11: E_SLAVE_UNDERFLOW}
    with pytest.raises(ControllerError, match=r"this machine was late by 33\.9 ms, the reply took 0\.1 ms"):
        play(controller, mode(0x102))


def test_mode_0_fills_the_buffer_and_then_keeps_the_period() -> None:
    controller = Controller()
    controller.codes = dict.fromkeys(range(2, 100), S_BUF_FULL)
    play(controller, mode(0x002))
    assert gaps(controller)[0] < 1
    assert gaps(controller)[1] < 1
    assert set(gaps(controller)[2:]) == {8}


def test_mode_0_sends_again_what_found_the_buffer_full() -> None:
    controller = Controller()
    controller.codes = {**dict.fromkeys(range(100), S_BUF_FULL), 10: E_SLAVE_OVERFLOW, 11: E_SLAVE_OVERFLOW}
    pacer = play(controller, mode(0x002))
    assert controller.points[9:14] == [9, 10, 10, 10, 11]
    assert pacer.counts.repeated == 2
    assert gaps(controller)[10:13] == [1, 1, 8]


def test_who_should_set_the_pace_and_does_not_sets_none() -> None:
    controller = Controller()
    pacer = play(controller, mode(0x202))
    assert max(gaps(controller)[:4]) < 1
    assert min(gaps(controller)[6:]) >= MIN_PERIOD_SHARE * 8
    assert pacer.counts.held > 30


def test_the_reply_is_the_deadline_where_the_controller_waits() -> None:
    controller = Controller()
    controller.takes = {number: 1_700_000 if number % 4 == 3 else None for number in range(4 * POINTS)}
    pacer = play(controller, mode(0x002, Generation.RC7))
    assert set(gaps(controller)) == {2}  # a try each 2 ms until the reply comes, and 0.3 ms to get ready
    assert pacer.lateness.exact_spread().most == 0
    assert pacer.counts.retries == 3 * POINTS


def first_and_last(controller: Controller) -> tuple[int, int]:
    """Count how often the first and the last point were sent."""
    return controller.points.count(0), controller.points.count(POINTS - 1)


def test_the_first_and_the_last_point_are_held() -> None:
    controller = Controller()
    pacer = play(controller, mode(0x102), hold=4)
    assert first_and_last(controller) == (5, 5)
    assert pacer.counts.sent == POINTS + 8
    point: SetPointValues = pacer.commanded
    assert point[0] == POINTS - 1


class Flood(Controller):
    """A controller on TCP that holds all replies back, then sends them together.

    Attributes:
        until: when it sends what it has held back, ns.
        reads: ns that it takes to read a reply.
    """

    datagrams = False
    until = 20 * MS
    reads = 50_000

    def send(self, data: bytes) -> None:
        super().send(data)
        due, reply = self._replies.pop()
        self._replies.append((max(due, self.until), reply))

    def receive(self, until: int) -> bytes | None:
        data = super().receive(until)
        if data is not None:
            self._now += self.reads
        return data


def test_replies_that_come_together_make_no_set_point_late() -> None:
    controller = Flood()
    pacer = play(controller, mode(0x102), period=MS)
    assert set(gaps(controller)) == {1}
    assert pacer.lateness.exact_spread().most == 0
    assert pacer.counts.late > 10


def test_an_order_is_obeyed_while_a_reply_is_waited_for() -> None:
    controller = Controller()
    controller.datagrams = False
    controller.takes = dict.fromkeys(range(10, 100))
    ordered = 300 * MS

    def idle(now: int) -> None:
        if now >= ordered:
            raise HaltedError

    with pytest.raises(HaltedError):
        play(controller, mode(0x102), idle=idle)
    assert controller.now() - ordered <= 8 * MS


@pytest.mark.parametrize("takes", [pytest.param(MS, id="answered"), pytest.param(None, id="unanswered")])
@pytest.mark.parametrize("value", [0x102, 0x202])
def test_an_order_is_obeyed_while_a_deadline_is_waited_for(value: int, takes: int | None) -> None:
    controller = Controller()
    controller.datagrams = False
    controller.takes = dict.fromkeys(range(POINTS), takes)
    ordered = 2350 * MS

    def idle(now: int) -> None:
        if now >= ordered:
            raise HaltedError

    with pytest.raises(HaltedError):
        play(controller, mode(value), idle=idle, period=1000 * MS)
    assert controller.now() - ordered <= 16 * MS


def test_a_controller_that_falls_behind_is_waited_for() -> None:
    controller = Controller()
    controller.datagrams = False
    controller.takes = dict.fromkeys(range(100), 150 * MS)
    pacer = play(controller, mode(0x102))
    assert controller.points == list(range(POINTS))
    waits = [gap for gap in gaps(controller) if gap > 8]
    assert waits
    assert all(gap > 140 for gap in waits)
    assert pacer.counts.unanswered < 150 / 8 + 1
    assert pacer.lateness.exact_spread().most == 0


@pytest.mark.parametrize(
    ("oversleeps", "takes", "stay", "late", "reply"),
    [
        pytest.param(22 * MS, 1 * MS, 29.8, 22.0, 1.0, id="we"),
        pytest.param(0, 14 * MS, 14.3, 0.0, 14.0, id="the reply"),
    ],
)
def test_whose_lateness_it_was_is_told(
    oversleeps: int, takes: int, stay: float, late: float, reply: float
) -> None:
    controller = Controller()
    controller.datagrams = False
    controller.oversleeps, controller.takes = {10: oversleeps}, {9: takes}
    controller.codes = {11: E_SLAVE_UNDERFLOW}
    told = (
        f"; {stay} ms between two set points: this machine was late by {late} ms, the reply took {reply} ms"
    )
    with pytest.raises(ControllerError, match=f"{told}$"):
        play(controller, mode(0x202))


def test_tries_that_come_too_late_are_our_lateness() -> None:
    controller = Controller()
    controller.takes = {10: 3 * MS, 11: MS}
    controller.codes = {13: E_SLAVE_UNDERFLOW}
    controller.naps = {10: 15 * MS}
    with pytest.raises(ControllerError, match=r"this machine was late by 13\.0 ms"):
        play(controller, mode(0x202))


def test_a_reply_that_waited_for_us_did_not_take_long() -> None:
    controller = Controller()
    controller.stops = {10: 900 * MS}
    controller.codes = {11: E_SLAVE_UNDERFLOW}
    with pytest.raises(ControllerError, match=r"this machine was late by 898\.0 ms, the reply took 0\.1 ms"):
        play(controller, mode(0x202))
