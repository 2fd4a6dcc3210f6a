"""What the time is while nobody gives us a processor."""

from __future__ import annotations

import pytest

from bcapscope.simulator.simulator_clock import STALL_NS, SimulatorClock

MS = 1_000_000
EPOCH = 1_700_000_000_000_000_000


class Machine:
    """Something that is due at 100 ms, on a machine whose clocks go when they are told to.

    Attributes:
        time: ns of that machine.
    """

    def __init__(self, keeps_time: bool = False, waits: bool = False) -> None:
        self.runs_in_real_time = keeps_time
        self.has_running_calls = waits
        self.time = 92 * MS
        self.clock = SimulatorClock(self, lambda: self.time, lambda: EPOCH + self.time)

    def due(self, now: int) -> int:
        """Return when."""
        return 100 * MS

    def came(self, at: int) -> int:
        """Return what the controller's time was then, in ms."""
        return self.clock.arrival_time(EPOCH + at * MS) // MS


def test_time_stands_still_where_something_was_due() -> None:
    machine = Machine()
    assert machine.clock.update() == 92 * MS
    machine.time = 130 * MS
    assert machine.clock.update() == 100 * MS
    assert machine.clock.paused_ns == 30 * MS
    machine.time = 131 * MS
    assert machine.clock.update() == machine.clock.now() == 101 * MS


def test_a_little_late_is_the_way_of_the_world() -> None:
    machine = Machine()
    machine.time = 100 * MS + STALL_NS
    assert machine.clock.update() == machine.time


def test_where_clients_go_on_so_does_the_time() -> None:
    machine = Machine(keeps_time=True)
    machine.time = 130 * MS
    assert machine.clock.update() == machine.time
    assert machine.came(110) == 110


@pytest.mark.parametrize(
    ("came", "heard"),
    [
        pytest.param(95, 95, id="before it was due, however late we look"),
        pytest.param(100, 100, id="just then"),
        pytest.param(129, 100, id="while the time stood still"),
        pytest.param(131, 101, id="since"),
        pytest.param(140, 101, id="a clock that was put back meanwhile"),
    ],
)
def test_what_came_is_heard_as_of_when_it_came(came: int, heard: int) -> None:
    machine = Machine()
    machine.time = 130 * MS
    machine.clock.update()
    machine.time = 131 * MS
    assert machine.came(came) == heard


def test_no_time_that_is_told_goes_back() -> None:
    machine = Machine()
    assert machine.clock.make_monotonic(97 * MS) == 97 * MS
    machine.time = 99 * MS
    assert machine.came(93) == 97
    assert machine.clock.make_monotonic(96 * MS) == 97 * MS


def test_time_stands_still_while_a_request_waits_that_a_controller_would_have_answered() -> None:
    machine = Machine()
    machine.time = 98 * MS
    assert [machine.came(at) for at in (93, 95)] == [93, 93]
    assert machine.clock.update() == 93 * MS
    machine.time = 99 * MS
    assert (machine.clock.update() // MS, machine.came(98)) == (94, 93)


def test_a_request_that_comes_while_a_call_waits_for_time_does_not_stop_it() -> None:
    machine = Machine(waits=True)
    machine.time = 98 * MS
    assert [machine.came(at) for at in (93, 95)] == [93, 95]
    assert machine.clock.update() == 98 * MS


def test_to_answer_takes_no_time() -> None:
    machine = Machine()
    machine.clock.make_monotonic(machine.clock.update())
    machine.time = 99 * MS
    machine.clock.on_replies_sent()
    assert (machine.clock.update() // MS, machine.came(95)) == (92, 92)
