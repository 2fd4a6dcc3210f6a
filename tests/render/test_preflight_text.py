"""What a file was read as, and the pre-flight, as text and as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from bcapscope.messages import Message
from bcapscope.player.arm_limits import SIMULATED_ARM, UNKNOWN_ARM
from bcapscope.player.preflight import run_preflight
from bcapscope.player.trajectory import Column, TrajectorySource
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import ANSI
from bcapscope.render.preflight_text import PreflightRenderer, preflight_record, source_lines, trajectory_line
from tests.cli.run import CAPTURES
from tests.player.ways import PERIOD, swing, way

HOSTILE = "\x1b[31m[/foo]\n\u202e\ud800"


def test_what_a_log_was_read_as() -> None:
    (trajectory,) = read_trajectories(CAPTURES / "control-log.csv")
    shown = list(source_lines(replace(trajectory, source=replace(trajectory.source, path="log.csv"))))
    assert shown[:4] == [
        "log.csv: control log, Shift-JIS (cp932)",
        "  251 set points, J type, J1 to J8, one every 8 ms",
        "  J1       from column 1, [J1 - 指令値]                        in deg",
        "  J2       from column 5, [J2 - 指令値]                        in deg",
    ]
    assert shown[-2:] == [
        "  counter  from column 37, [コントローラ起動時からのカウンタ]",
        "  the counter grows by 8, which is read as ms",
    ]


def test_several_to_choose_from() -> None:
    lines = [
        trajectory_line(number, each)
        for number, each in enumerate(read_trajectories(CAPTURES / "two-robots.pcapng"), 1)
    ]
    assert (
        lines[0]
        == "1: slave-mode session 1, 192.168.0.10:50001, mode not seen, 12 set points, J type, J1 to J8"
    )
    assert trajectory_line(1, way([[1]])) == "1: all of it, 1 set point, J type, J1"


def test_intervals() -> None:
    assert "one every 8 ms" in list(source_lines(way([[1], [2]])))[1]
    assert "interval not given" in list(source_lines(way([[1], [2]], period=None)))[1]
    assert "with uneven times" in list(source_lines(way([[1], [2]], period=None, times=[0, 1])))[1]


def test_a_pre_flight_that_is_fit() -> None:
    shown = list(PreflightRenderer().lines(run_preflight(way(swing(degrees=40)), PERIOD, SIMULATED_ARM)))
    assert shown[:2] == [
        "axis  unit     from      to    step       speed/s  acceleration/s²  fastest at",
        "J1    deg     0.000  40.000  0.8645  108.1 of 300    789.3 of 6000          98",
    ]
    assert shown[-1] == "fit to play: 251 set points, 2.000 s, limits of the simulated arm"


def test_a_pre_flight_that_is_not() -> None:
    preflight = run_preflight(way(swing(degrees=40), period=0.01), PERIOD, current_pose=(9.0,) * 8)
    shown = list(PreflightRenderer(width=80).lines(preflight))
    assert shown[shown.index("") + 1 :] == [
        "error interval: the set points are 10 ms apart, but slvMove is sent every 8",
        "  ms. The robot would move at 1.25 times the speed",
        "  what to do: resample it, which also gives it a smooth start and stop",
        "warning first-point: the first point is away from the robot's position: J1 -9",
        "  deg, J2 -9 deg, J3 -9 deg, J4 -9 deg, J5 -9 deg, J6 -9 deg (set point 1)",
        "  what to do: move there slowly first",
        "note limits: the limits of this arm are unknown: speeds are shown but not",
        "  checked",
        "  what to do: give limits, such as J1=-170..170 or J1.speed=300",
        "not fit to play: 251 set points, 2.500 s, limits of an unknown arm",
    ]
    assert all(display_width(line) <= 80 for line in shown)


def test_colours_are_only_where_they_are_asked_for() -> None:
    preflight = run_preflight(way(swing(), period=0.01), PERIOD)
    assert "\x1b" not in "".join(PreflightRenderer().lines(preflight))
    assert f"{ANSI.problem}error interval:{ANSI.reset} the set" in "\n".join(
        PreflightRenderer(ANSI).lines(preflight)
    )


def test_json_has_all_of_it() -> None:
    rows = swing()
    rows[3, 1] = math.nan
    trajectory = way(rows, columns=(Column("J1", 4, "J1 (rad)", "rad", 57.3),))
    record = json.loads(preflight_record(run_preflight(trajectory, PERIOD, current_pose=(1.0,) * 8)))
    assert (record["type"], record["set_points"], record["period_ms"], record["cycle_ms"]) == (
        "J",
        251,
        8.0,
        8.0,
    )
    assert record["columns"] == [
        {"axis": "J1", "column": 4, "title": "J1 (rad)", "unit": "rad", "factor": 57.3}
    ]
    assert (record["fit"], record["needs_move"], record["distance"], record["axes"]) == (
        False,
        False,
        None,
        [],
    )
    assert record["findings"][0]["check"] == "not-finite"
    assert record["findings"][0]["points"] == [4]
    record = json.loads(
        preflight_record(run_preflight(way(swing()), PERIOD, UNKNOWN_ARM, current_pose=(1.0,) * 8))
    )
    assert record["distance"] == [-1.0] * 6
    assert record["axes"][0]["limits"]["speed"] is None
    assert np.isclose(record["axes"][0]["high"], 30)


def test_hostile_strings_are_shown_as_what_they_are() -> None:
    columns = (Column("J1", 1, HOSTILE, "deg"), Column("time", 0, HOSTILE))
    text = Message.from_table("text", HOSTILE)
    source = TrajectorySource(HOSTILE, text, text, columns, (text,))
    trajectory = replace(way([[1], [2]]), source=source)
    shown = "".join((*source_lines(trajectory), trajectory_line(1, trajectory)))
    assert shown.isprintable()
    record = preflight_record(run_preflight(trajectory, PERIOD)).decode()
    assert record.isprintable()
    assert json.loads(record)["notes"] == ["\\x1b[31m[/foo]\\n\\u202e\\ud800"]


@pytest.mark.parametrize("period", [1e300, 1e-300, 1e15])
def test_absurd_intervals_take_no_more_columns(period: float) -> None:
    trajectory = way([[0], [1], [3]], period=period)
    with np.errstate(all="raise"):
        preflight = run_preflight(trajectory, PERIOD)
    shown = [*PreflightRenderer(width=80).lines(preflight), *source_lines(trajectory)]
    assert max(map(display_width, shown)) <= 90
    assert not preflight.is_playable
    assert json.loads(preflight_record(preflight))["fit"] is False
