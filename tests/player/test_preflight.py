"""The pre-flight: each check with a case that fires it and one that does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Message
from bcapscope.player.arm_limits import SIMULATED_ARM, UNKNOWN_ARM, ArmLimits, with_limits
from bcapscope.player.checks import MAX_NUMBERS, PreflightProblem
from bcapscope.player.preflight import PreflightResult, run_preflight
from bcapscope.player.resampling import resample
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import Column, Trajectory
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, slave_mode_by_number
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.simulator.kinematics import position, trans
from tests.player.ways import PERIOD, swing, way

ERROR, WARNING, NOTE = Severity
HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)
JOINTS = swing() + HOME[:6]


def positions() -> Array:
    return np.array([position(tuple(row)) for row in JOINTS.tolist()])


def found(preflight: PreflightResult) -> set[str]:
    return {finding.check for finding in preflight.problems}


def one(preflight: PreflightResult, name: str) -> PreflightProblem:
    (finding,) = [each for each in preflight.problems if each.check == name]
    return finding


def test_a_good_trajectory_has_no_finding() -> None:
    preflight = run_preflight(
        way(JOINTS), PERIOD, SIMULATED_ARM, current_pose=HOME, mode=slave_mode_by_number(0x202), loop=True
    )
    assert preflight.problems == ()
    assert preflight.is_playable
    assert not preflight.needs_approach
    assert preflight.seconds == 2.0
    assert preflight.first_point_offsets == (0,) * 6


def test_positions_are_checked_as_joints_too() -> None:
    preflight = run_preflight(
        way(positions(), PoseType.P), PERIOD, SIMULATED_ARM, current_pose=position(HOME)
    )
    assert preflight.problems == ()
    names = [figures.axis.name for figures in preflight.axis_figures]
    assert names == ["X", "Y", "Z", "Rx", "Ry", "Rz", "J1", "J2", "J3", "J4", "J5", "J6"]


@dataclass
class Fault:
    """A trajectory with one fault."""

    check: str
    severity: Severity
    sentence: str
    points: tuple[int, ...]
    count: int
    preflight: PreflightResult


def changed(rows: Array, row: int | slice, column: int, value: float) -> Array:
    copy = rows.copy()
    copy[row, column] = value
    return copy


FACING = (400, 0, 500, 0, 1, 0, 0, 0, 1, 1)
TURNED_ROUND = (400, 0, 500, 0, 1, 0, 0, 0, -1, 1)
RETURNING = way([[0], [0], [0.3], [0.6], [0.9], [1.2], [1.2], [1.0], [0.5]], period=0.1)
FAST = way([[0], [1], [3], [4]], period=0.1)
FIGS = changed(positions(), slice(100, None), 6, 5)
TURNED = np.array([trans(tuple(row)) for row in JOINTS.tolist()])
UNITS_KNOWN = tuple(Column(axis.name, 1, "", "rad") for axis in AXES[PoseType.J][:6])

FAULTS = [
    Fault(
        "not-finite",
        ERROR,
        "NaN, infinity or a number beyond 1e+09 in 2 set points of 251",
        (5, 9),
        2,
        run_preflight(way(changed(changed(JOINTS, 4, 0, np.nan), 8, 5, np.inf)), PERIOD),
    ),
    Fault(
        "mode",
        ERROR,
        "slave mode 0x101 takes P type, but the set points are of J type",
        (),
        0,
        run_preflight(way(JOINTS), PERIOD, mode=slave_mode_by_number(0x101, Generation.RC7)),
    ),
    Fault(
        "axes",
        ERROR,
        "the robot has 4 axes, the file moves J5 and J6",
        (),
        0,
        run_preflight(way(JOINTS), PERIOD, ArmLimits(Message("arm.unknown"), axis_count=4)),
    ),
    Fault(
        "axes",
        NOTE,
        "not in the file, so these axes keep their present position: J7 and J8",
        (),
        0,
        run_preflight(way(JOINTS), PERIOD, ArmLimits(Message("arm.unknown"), axis_count=8)),
    ),
    Fault(
        "axes",
        NOTE,
        "not in the file, so these axes keep their present position: Fig",
        (),
        0,
        run_preflight(way(positions()[:, :6], PoseType.P), PERIOD),
    ),
    Fault(
        "fig",
        WARNING,
        "Fig changes once, first from 1 to 5: the arm cannot change its posture from one point to the next",
        (101,),
        1,
        run_preflight(way(FIGS, PoseType.P), PERIOD),
    ),
    Fault(
        "first-point",
        WARNING,
        "the first point has Fig 1, but the robot has 5 now",
        (1,),
        1,
        run_preflight(way(positions(), PoseType.P), PERIOD, current_pose=(*position(HOME)[:6], 5.0)),
    ),
    Fault(
        "fig",
        ERROR,
        "Fig is not a whole number in 251 set points",
        tuple(range(1, MAX_NUMBERS + 1)),
        251,
        run_preflight(way(changed(positions(), slice(None), 6, 1.5), PoseType.P), PERIOD),
    ),
    Fault(
        "directions",
        ERROR,
        "orientation and approach are not unit vectors at a right angle in 1 set point",
        (8,),
        1,
        run_preflight(way(changed(TURNED, 7, 3, 2.0), PoseType.T), PERIOD),
    ),
    Fault(
        "cycle",
        ERROR,
        "in slave mode 0x202 the controller takes a set point every 8 ms. With slvMove only every 16 ms, "
        "slave mode would end",
        (),
        0,
        run_preflight(way(JOINTS, period=0.016), 0.016, mode=slave_mode_by_number(0x202)),
    ),
    Fault(
        "cycle",
        WARNING,
        "in slave mode 0x002 the controller takes a set point every 8 ms, so playing takes 2 times as long",
        (),
        0,
        run_preflight(way(JOINTS, period=0.004), 0.004, mode=slave_mode_by_number(0x002, Generation.RC7)),
    ),
    Fault(
        "interval",
        ERROR,
        "the set points are 10 ms apart, but slvMove is sent every 8 ms. The robot would move at 1.25 times "
        "the speed",
        (),
        0,
        run_preflight(way(JOINTS, period=0.01), PERIOD),
    ),
    Fault(
        "interval",
        WARNING,
        "the file does not give the interval; 8 ms is assumed",
        (),
        0,
        run_preflight(way(JOINTS, period=None), PERIOD),
    ),
    Fault(
        "interval",
        ERROR,
        "the set points are 10 ms to 12 ms apart, but slvMove is sent every 8 ms",
        (),
        0,
        run_preflight(way([[0]] * 3, period=None, times=[0, 0.01, 0.022]), PERIOD),
    ),
    Fault(
        "gap",
        WARNING,
        "1 gap in the times; the longest is 40 ms, and 8 ms are usual",
        (4,),
        1,
        run_preflight(way([[0]] * 6, period=None, times=[0, 0.008, 0.016, 0.056, 0.064, 0.072]), PERIOD),
    ),
    Fault(
        "time-order",
        ERROR,
        "the time of 2 set points is not later than that of the one before",
        (3, 5),
        2,
        run_preflight(way([[0]] * 5, period=None, times=[0, 1, 1, 2, 1]), PERIOD),
    ),
    Fault(
        "range",
        ERROR,
        "J1 goes from 0 to 30 deg, but its limits are -10 and 20: 51 set points",
        tuple(range(101, 109)),
        51,
        run_preflight(way(JOINTS), PERIOD, with_limits(UNKNOWN_ARM, ["J1=-10..20"])),
    ),
    Fault(
        "speed",
        ERROR,
        "J1 reaches 20 deg/s, but its limit is 15: 1 set point",
        (3,),
        1,
        run_preflight(FAST, 0.1, with_limits(UNKNOWN_ARM, ["J1.speed=15"])),
    ),
    Fault(
        "speed",
        ERROR,
        "J1 reaches 1.25e+04 deg/s, more than any arm reaches: 2 set points",
        (3, 4),
        2,
        run_preflight(way([[0], [0], [100], [0], [0]]), PERIOD),
    ),
    Fault(
        "speed",
        ERROR,
        "Ox..Az reaches 2.25e+04 deg/s, more than any arm reaches: 1 set point",
        (3,),
        1,
        run_preflight(way([FACING, FACING, TURNED_ROUND], PoseType.T), PERIOD),
    ),
    Fault(
        "acceleration",
        ERROR,
        "J1 accelerates by 50 deg/s², but its limit is 40: 1 set point",
        (1,),
        1,
        run_preflight(RETURNING, 0.1, with_limits(UNKNOWN_ARM, ["J1.acceleration=40"]), loop=True),
    ),
    Fault(
        "acceleration",
        ERROR,
        "J1 accelerates by 100 deg/s², but its limit is 99: 4 set points",
        (1, 2, 3, 4),
        4,
        run_preflight(FAST, 0.1, with_limits(UNKNOWN_ARM, ["J1.acceleration=99"])),
    ),
    Fault(
        "reach",
        ERROR,
        "the simulated arm does not reach 1 set point",
        (3,),
        1,
        run_preflight(way(changed(positions(), 2, 0, 4000.0), PoseType.P), PERIOD, SIMULATED_ARM),
    ),
    Fault(
        "limits",
        NOTE,
        "the limits of this arm are unknown: speeds are shown but not checked",
        (),
        0,
        run_preflight(way(JOINTS), PERIOD),
    ),
    Fault(
        "rest",
        WARNING,
        "the trajectory ends at speed: J1 at 40 deg/s",
        (3,),
        1,
        run_preflight(way([[0], [0], [4]], period=0.1), 0.1),
    ),
    Fault(
        "rest",
        WARNING,
        "the trajectory begins at speed: J1 at 40 deg/s",
        (1,),
        1,
        run_preflight(way([[0], [4], [4]], period=0.1), 0.1),
    ),
    Fault(
        "first-point",
        WARNING,
        "the first point is away from the robot's position: J1 -12 deg, J3 +0.1 deg",
        (1,),
        1,
        run_preflight(way(JOINTS), PERIOD, current_pose=(12, 0, 89.9, 0, 90, 0.01, 0, 0)),
    ),
    Fault(
        "first-point",
        WARNING,
        "the first point is away from the robot's position: Ox..Az +180 deg",
        (1,),
        1,
        run_preflight(way([FACING] * 3, PoseType.T), PERIOD, current_pose=TURNED_ROUND),
    ),
    Fault(
        "rest",
        WARNING,
        "the trajectory ends at speed: J1 at 5 deg/s",
        (9,),
        1,
        run_preflight(RETURNING, 0.1, loop=True),
    ),
    Fault(
        "loop",
        ERROR,
        "the last point is away from the first, and a loop returns there in one step: J1 -1 deg",
        (251, 1),
        2,
        run_preflight(way(JOINTS + np.linspace(0, 1, 251)[:, None] * [1, 0, 0, 0, 0, 0]), PERIOD, loop=True),
    ),
    Fault(
        "units",
        WARNING,
        "no joint goes beyond 1.53: these may be radians, and are read as degrees",
        (),
        0,
        run_preflight(way(np.radians(JOINTS) / 1.2), PERIOD),
    ),
    Fault(
        "units",
        WARNING,
        "X, Y and Z are all below 0.784: these may be metres, and are read as mm",
        (),
        0,
        run_preflight(way(positions() / [1000, 1000, 1000, 1, 1, 1, 1], PoseType.P), PERIOD),
    ),
    Fault(
        "still",
        NOTE,
        "the robot does not move: 5 set points, all the same",
        (),
        0,
        run_preflight(way([[1]] * 5), PERIOD),
    ),
]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.check}-{fault.severity}")
def test_a_fault_is_told(fault: Fault) -> None:
    findings = [each for each in fault.preflight.problems if each.check == fault.check]
    assert (fault.severity, fault.sentence, fault.points, fault.count) in [
        (each.severity, str(each.fact), each.points, each.count) for each in findings
    ]
    assert fault.preflight.is_playable is all(each.severity is not ERROR for each in fault.preflight.problems)


def test_every_check_has_a_fault() -> None:
    assert {fault.check for fault in FAULTS} >= {
        finding.check for fault in FAULTS for finding in fault.preflight.problems
    }


def test_the_gravest_come_first() -> None:
    preflight = run_preflight(FIGS_AND_MORE, PERIOD, SIMULATED_ARM, current_pose=(0.0,) * 7)
    rank = [list(Severity).index(finding.severity) for finding in preflight.problems]
    assert rank == sorted(rank)
    assert len(set(rank)) > 1


FIGS_AND_MORE = way(FIGS, PoseType.P, period=0.02)


def test_units_that_the_file_tells_are_believed() -> None:
    preflight = run_preflight(way(np.radians(JOINTS), columns=UNITS_KNOWN), PERIOD)
    assert "units" not in found(preflight)


def test_the_first_point_is_near_the_short_way_round() -> None:
    rows = positions()
    rows[:, 3] = 179.99
    preflight = run_preflight(
        way(rows, PoseType.P), PERIOD, current_pose=(*rows[0, :3].tolist(), -180.0, *rows[0, 4:].tolist())
    )
    assert not preflight.needs_approach
    assert preflight.first_point_offsets is not None
    assert preflight.first_point_offsets[3] == pytest.approx(-0.01)


@pytest.mark.parametrize(("first", "present"), [(-1, 5), (5, -2), (5, 5)])
def test_a_posture_that_is_left_to_the_controller_is_no_other(first: float, present: float) -> None:
    here = (400.0, 0.0, 500.0, 0.0, 90.0, 0.0)
    assert not run_preflight(
        way([[*here, first]], PoseType.P), PERIOD, current_pose=(*here, present)
    ).needs_approach


@pytest.mark.parametrize(("mode", "period"), [(0x102, 0.001), (0x102, 0.016), (0x202, 0.008)])
def test_where_we_set_the_pace_the_cycle_is_ours(mode: int, period: float) -> None:
    assert "cycle" not in found(
        run_preflight(way(JOINTS, period=period), period, mode=slave_mode_by_number(mode))
    )


def test_a_loop_that_is_closed_the_short_way_round() -> None:
    turning = np.zeros((91, 7))
    turning[:, 5] = 180 - np.mod(180 - np.arange(91) * 4.0, 360)
    assert "loop" not in found(run_preflight(way(turning, PoseType.P), PERIOD, loop=True))


def test_the_join_of_a_loop_counts_for_speed() -> None:
    rows = way(swing()[:190])
    assert (
        run_preflight(rows, PERIOD).axis_figures[0].speed
        < run_preflight(rows, PERIOD, loop=True).axis_figures[0].speed
    )


def test_figures() -> None:
    (figures,) = run_preflight(FAST, 0.1).axis_figures
    assert (figures.axis, figures.fastest) == (AXES[PoseType.J][0], 3)
    assert figures[1:6] == pytest.approx((0, 4, 2, 20, 100))


def test_speeds_are_those_of_the_file_whatever_slv_move_does() -> None:
    preflight = run_preflight(way(swing(), period=0.016), PERIOD)
    assert preflight.axis_figures[0].speed == pytest.approx(
        run_preflight(way(swing()), PERIOD).axis_figures[0].speed / 2
    )
    assert preflight.seconds == 4.0


def test_way_points_have_no_speed_yet() -> None:
    preflight = run_preflight(way([[0], [90], [0]], period=None, times=[0, 1, 3]), PERIOD, loop=True)
    assert found(preflight) == {"axes", "interval", "limits"}
    assert preflight.axis_figures == ()
    assert preflight.seconds == 3
    far = run_preflight(way([[0], [190]], period=None, times=[0, 1]), PERIOD, SIMULATED_ARM)
    assert "range" in found(far)


def test_one_point_is_enough() -> None:
    preflight = run_preflight(way([[1, 2, 3]]), PERIOD, SIMULATED_ARM, current_pose=HOME, loop=True)
    assert found(preflight) == {"first-point", "still", "axes"}
    assert preflight.seconds == 0


NUMBER = st.floats() | st.floats(-400, 400)


@st.composite
def anything(draw: st.DrawFn) -> Trajectory:
    kind = draw(st.sampled_from(PoseType))
    width = len(AXES[kind])
    rows = draw(st.lists(st.lists(NUMBER, min_size=width, max_size=width), min_size=1, max_size=6))
    times = draw(st.none() | st.lists(NUMBER, min_size=len(rows), max_size=len(rows)))
    return way(rows, kind, draw(st.none() | st.floats(1e-4, 10)), times)


@given(
    anything(),
    st.sampled_from([UNKNOWN_ARM, SIMULATED_ARM]),
    st.none() | st.lists(st.floats(-400, 400), max_size=10),
    st.booleans(),
)
@pytest.mark.filterwarnings("error")
def test_no_trajectory_breaks_it(
    trajectory: Trajectory, limits: ArmLimits, present: list[float] | None, loop: bool
) -> None:
    preflight = run_preflight(trajectory, PERIOD, limits, current_pose=present, loop=loop)
    assert preflight.is_playable or preflight.problems


@given(st.floats(5, 60), st.floats(0.3, 3), st.sampled_from([0.25, 0.5, 1.0]))
def test_what_was_resampled_is_checked_as_what_it_is(degrees: float, seconds: float, speed: float) -> None:
    trajectory = resample(way(swing(seconds, degrees)), PERIOD, speed=speed)
    preflight = run_preflight(trajectory, PERIOD, UNKNOWN_ARM, loop=True)
    assert found(preflight) <= {"limits", "units"}
