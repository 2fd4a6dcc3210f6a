"""Trajectory files: the text is what the docstring of `render.trajectory_file` says."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.slave.captured_trajectory import CapturedTrajectory, TrajectoryStep
from bcapscope.analysis.slave.slave_session import KnownMode
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, slave_mode_by_number
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.render.trajectory_file import CsvTrajectoryWriter, JsonTrajectoryWriter, column_names
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport

SOURCE = Message("generation.command", command="TakeArm")
START = 1_700_000_000_000_000_000
TALK = Conversation(Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT)


def trajectory(pose_type: PoseType = PoseType.P, has_stamps: bool = True) -> CapturedTrajectory:
    meaning = slave_mode_by_number(0x201, Generation.RC8)
    mode = KnownMode(0x201, "slvChangeMode", Generation.RC8, SOURCE, meaning, False, pose_type)
    return CapturedTrajectory(3, TALK, 7, mode, None, None, AXES[pose_type], START, has_stamps, 8.0)


def step(call: int, time: int, commanded: Sequence[float], returned: Sequence[float] = ()) -> TrajectoryStep:
    return TrajectoryStep(call, START + time, START + time + 1, 0, 0, tuple(commanded), tuple(returned), 4.5)


POSE = (1.0, -2.5, 1e-07, 0.1, 179.99999999999997, -0.0, 5.0)


def test_csv_columns() -> None:
    writer = CsvTrajectoryWriter(trajectory())
    text = writer.head() + writer.rows([step(4, 8_000_001, POSE, POSE[::-1])]) + writer.tail()
    assert text.decode("ascii").splitlines() == [
        "time_s,X_mm,Y_mm,Z_mm,Rx_deg,Ry_deg,Rz_deg,Fig,returned_X_mm,returned_Y_mm,returned_Z_mm,"
        "returned_Rx_deg,returned_Ry_deg,returned_Rz_deg,returned_Fig,reply_s,controller_time_ms,retries,"
        "hresult,call",
        "0.008000001,1.0,-2.5,1e-7,0.1,179.99999999999997,-0.0,5.0,5.0,-0.0,179.99999999999997,0.1,1e-7,"
        "-2.5,1.0,0.008000002,4.5,0,0,4",
    ]


def test_what_there_is_not_stays_empty() -> None:
    unanswered = step(4, 0, POSE)._replace(reply_time=None, hresult=None, stamp=None)
    row = CsvTrajectoryWriter(trajectory()).rows([unanswered]).decode().rstrip("\n").split(",")
    names = column_names(trajectory())
    empty = {name for name, cell in zip(names, row, strict=True) if not cell}
    returned = {name for name in names if name.startswith("returned_")}
    assert empty == {*returned, "reply_s", "controller_time_ms", "hresult"}


@pytest.mark.parametrize("pose_type", list(PoseType))
@pytest.mark.parametrize("has_stamps", [False, True])
def test_rows_have_a_cell_for_each_column(pose_type: PoseType, has_stamps: bool) -> None:
    made = trajectory(pose_type, has_stamps)
    steps = [step(1, 0, range(len(made.axes))), step(2, 5, range(len(made.axes)), range(len(made.axes)))]
    table = CsvTrajectoryWriter(made)
    lines = list(csv.reader((table.head() + table.rows(steps)).decode().splitlines()))
    assert {len(line) for line in lines} == {len(column_names(made))}
    book = JsonTrajectoryWriter(made)
    read = json.loads(book.head() + book.rows(steps[:1]) + book.rows(steps[1:]) + book.tail())
    assert read["columns"] == lines[0]
    assert [len(row) for row in read["rows"]] == [len(lines[0])] * 2
    assert read["points"] == 2


def test_what_the_json_knows_besides() -> None:
    writer = JsonTrajectoryWriter(trajectory())
    read = json.loads(writer.head() + writer.tail())
    assert read["rows"] == []
    assert {name: read[name] for name in ("format", "stay", "client", "server", "transport", "robot")} == {
        "format": "bcapscope trajectory 1",
        "stay": 3,
        "client": "10.0.0.2:50001",
        "server": "10.0.0.1:5007",
        "transport": "udp",
        "robot": 7,
    }
    assert (read["mode"], read["pose_type"], read["generation"]) == (0x201, "P", "RC8")
    assert (read["start"], read["start_utc"]) == (1_700_000_000, "2023-11-14T22:13:20.000000000Z")
    assert read["axes"][0] == {"name": "X", "unit": "mm"}
    assert read["interval_ms"] == 8.0
    assert read["receive_format"] is None


@given(st.lists(st.tuples(*[st.floats()] * 7), min_size=1, max_size=5))
def test_numbers_read_back_as_they_were(poses: list[tuple[float, ...]]) -> None:
    steps = [step(number, number, pose, pose) for number, pose in enumerate(poses)]
    made = trajectory()
    for row, pose in zip(
        csv.reader(CsvTrajectoryWriter(made).rows(steps).decode().splitlines()), poses, strict=True
    ):
        assert list(map(repr, map(float, row[1:8]))) == list(map(repr, pose))
    book = JsonTrajectoryWriter(made)
    text = book.head() + book.rows(steps) + book.tail()
    read = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    for row, pose in zip(read["rows"], poses, strict=True):
        for found, sent in zip(row[8:15], pose, strict=True):
            assert float(found) == sent or (math.isnan(sent) and found == "NaN")
