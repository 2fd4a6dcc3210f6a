"""Trajectories from JSON and YAML: the JSON of `bcapscope extract`, and ROS messages as JSON or YAML.

A JointTrajectory (trajectory_msgs of ROS 1 and 2) has `joint_names` and `points` with `positions` in radians
and `time_from_start`. A JointTrajectory may be a part of another message, such as MoveIt's RobotTrajectory.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import degrees, isfinite
from typing import Any

import numpy as np
import yaml

from bcapscope.faults.yaml_events import YamlError, yaml_events
from bcapscope.messages import Message
from bcapscope.player.column_layout import ReadOptions, layout_of_titles, list_titles
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import (
    MAX_POINTS,
    Column,
    SetPointTiming,
    Trajectory,
    TrajectoryError,
    TrajectorySource,
    float_or_nan,
    timing_from_due_times,
)
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES

EXTRACT_FORMAT = "bcapscope trajectory 1"

MAX_VALUES = 1_500_000
"""Maximum number of values, enough for 28 minutes with six joints and a time every 8 ms. The values take up
to 110 MB of memory.
"""

TOO_MANY_VALUES = Message("trajectory.too-many-values", limit=MAX_VALUES)

_DEEPEST, _MAX_TRAJECTORIES, _SHOWN = 8, 256, 40
_DEGREES_PER_RADIAN = degrees(1.0)
_NONE = (None, "", "~", "null")  # the YAML reader returns a missing value as one of these texts
_LAST_NUMBER = re.compile(r"(\d+)\D*$")
_AXIS_NUMBERS = range(1, len(AXES[PoseType.J]) + 1)


def read_documents(
    documents: Sequence[object], source: TrajectorySource, options: ReadOptions
) -> tuple[Trajectory, ...]:
    """Read trajectories from the documents of a parsed file, or raise TrajectoryError if there are none. For
    ROS messages, only the pose type in `options` is used, and must be J or None.
    """
    only = documents[0] if len(documents) == 1 else None
    if isinstance(only, dict) and only.get("format") == EXTRACT_FORMAT:
        return (_read_extract(only, source, options),)
    seen: set[int] = set()
    found = [message for document in documents for message in _find_ros_messages(document, _DEEPEST, seen)]
    if not found:
        keys = [str(key) for document in documents if isinstance(document, dict) for key in document]
        if keys:
            raise TrajectoryError(Message("trajectory.none-but", keys=list_titles(keys)))
        raise TrajectoryError(Message("trajectory.none"))
    if len(found) > _MAX_TRAJECTORIES:
        raise TrajectoryError(Message("trajectory.too-many", limit=_MAX_TRAJECTORIES))
    if options.kind not in (None, PoseType.J):
        raise TrajectoryError(Message("trajectory.ros-kind", kind=str(options.kind)))
    parts = [Message("trajectory.part.number", number=number + 1) for number in range(len(found))]
    return tuple(
        _read_ros(message, replace(source, part=part if len(found) > 1 else None))
        for message, part in zip(found, parts, strict=True)
    )


def _read_extract(document: dict[str, Any], source: TrajectorySource, options: ReadOptions) -> Trajectory:
    titles, rows = document.get("columns"), document.get("rows")
    if not isinstance(titles, list) or not all(isinstance(title, str) for title in titles):
        raise TrajectoryError(Message("trajectory.columns-no-list"))
    if not isinstance(rows, list) or not rows:
        raise TrajectoryError(Message("trajectory.rows-no-list"))
    layout = layout_of_titles(titles, options)
    if layout is None:
        raise TrajectoryError(Message("trajectory.no-pose-columns", titles=list_titles(titles)))
    places = [column.position - 1 for column in layout.columns]
    names = [column.axis for column in layout.columns]
    points = _number_table(
        [_select_values(row, places, len(titles), number) for number, row in enumerate(rows, 1)], names
    )
    points *= [column.factor for column in layout.columns]
    session, interval = document.get("stay"), float_or_nan(document.get("interval_ms"))
    part = Message("trajectory.part.session-number", number=session) if isinstance(session, int) else None
    source = replace(
        source,
        file_format=Message("trajectory.format.extract", encoding=source.file_format or ""),
        part=part,
        columns=layout.columns,
        notes=(*source.notes, *layout.notes, Message("trajectory.note.one-cycle")),
    )
    period = interval / 1000 if isfinite(interval) and interval > 0 else None
    return Trajectory(layout.kind, points, source, period)


def _select_values(row: object, places: Sequence[int], width: int, number: int) -> list[object]:
    if not isinstance(row, list) or len(row) != width:
        raise TrajectoryError(Message("trajectory.row-no-list", number=number, width=width))
    return [row[place] for place in places]


def _find_ros_messages(node: object, deep: int, seen: set[int]) -> Iterator[dict[str, Any]]:
    """Yield each object that looks like a JointTrajectory. Search a repeated node (alias) only once."""
    if id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, dict):
        if isinstance(node.get("joint_names"), list) and isinstance(node.get("points"), list):
            yield node
            return
        children: Sequence[object] = list(node.values())
    else:
        children = node if isinstance(node, list) else ()
    if deep:
        for child in children:
            if isinstance(child, dict | list):
                yield from _find_ros_messages(child, deep - 1, seen)


def _read_ros(message: dict[str, Any], source: TrajectorySource) -> Trajectory:
    names, points = message["joint_names"], message["points"]
    if not names or not all(isinstance(name, str) for name in names):
        raise TrajectoryError(Message("trajectory.names-no-list"))
    if not 0 < len(points) <= MAX_POINTS:
        raise TrajectoryError(Message("trajectory.no-points", count=len(points)))
    order, notes = _joint_order(names)
    rows, seconds = [], []
    for number, point in enumerate(points, 1):
        positions = point.get("positions") if isinstance(point, dict) else None
        if not isinstance(positions, list) or len(positions) != len(names):
            raise TrajectoryError(Message("trajectory.no-positions", number=number, count=len(names)))
        rows.append([positions[place] for place in order])
        seconds.append(_seconds(point.get("time_from_start")))
    axes = [axis.name for axis in AXES[PoseType.J][: len(order)]]
    columns = [
        Column(axis, place + 1, names[place], "rad", _DEGREES_PER_RADIAN)
        for axis, place in zip(axes, order, strict=True)
    ]
    timing = SetPointTiming(None, None)
    if None not in seconds:
        timing = timing_from_due_times(np.array(seconds, dtype=np.float64))
        columns.append(Column("time", 0, "time_from_start", "s"))
    elif any(moment is not None for moment in seconds):
        raise TrajectoryError(Message("trajectory.no-time", number=seconds.index(None) + 1))
    source = replace(
        source,
        file_format=Message("trajectory.format.ros", encoding=source.file_format or ""),
        columns=tuple(columns),
        notes=(*source.notes, Message("trajectory.note.radians"), *notes),
    )
    points = _number_table(rows, axes) * _DEGREES_PER_RADIAN
    return Trajectory(PoseType.J, points, source, timing.period, timing.times)


def _joint_order(names: Sequence[str]) -> tuple[list[int], tuple[Message, ...]]:
    """Return the indices of J1, J2 and so on in `names`: by the numbers in the names, else as listed."""
    numbers = [_LAST_NUMBER.search(name) for name in names]
    by_number = {int(found[1]): place for place, found in enumerate(numbers) if found and len(found[1]) < 3}
    count = sum(found is not None for found in numbers)
    if count and len(by_number) == count and sorted(by_number) == list(_AXIS_NUMBERS[:count]):
        others = [name for name, found in zip(names, numbers, strict=True) if not found]
        left = (Message("trajectory.note.unnumbered", names=list_titles(others)),) if others else ()
        return [by_number[number] for number in sorted(by_number)], left
    if count == len(names) == len(by_number) and all(number in _AXIS_NUMBERS for number in by_number):
        numbered = ", ".join(f"J{number}" for number in sorted(by_number))
        raise TrajectoryError(Message("trajectory.joint-gap", names=numbered))
    if len(names) > len(_AXIS_NUMBERS):
        raise TrajectoryError(Message("trajectory.joint-names", count=len(names)))
    return list(range(len(names))), (Message("trajectory.note.listed-order", names=list_titles(names)),)


def _seconds(value: object) -> float | None:
    """Read a duration: a number, or an object with seconds and nanoseconds; return NaN for other values."""
    if value in _NONE:
        return None
    if isinstance(value, dict):
        whole, rest = value.get("sec", value.get("secs", 0)), value.get("nanosec", value.get("nsecs", 0))
        return float_or_nan(whole) + float_or_nan(rest) * 1e-9
    return float_or_nan(value)


def _number_table(rows: Sequence[Sequence[object]], names: Sequence[str]) -> Array:
    if len(rows) > MAX_POINTS:
        raise TrajectoryError(Message("trajectory.too-long", limit=MAX_POINTS))
    table = np.array([[float_or_nan(value) for value in row] for row in rows], dtype=np.float64)
    for place in np.argwhere(np.isnan(table)).tolist():
        value = rows[place[0]][place[1]]
        if not (isinstance(value, float) or (isinstance(value, str) and value.strip().casefold() == "nan")):
            shown = repr(value[:_SHOWN]) if isinstance(value, str) else type(value).__name__
            raise TrajectoryError(
                Message("trajectory.value-no-number", number=place[0] + 1, value=shown, axis=names[place[1]])
            )
    return table


def read_yaml(data: bytes) -> Iterator[object]:
    """Yield the documents of a YAML stream as lists, dictionaries and text, or raise TrajectoryError.

    All values stay text, even numbers. PyYAML's own loaders would first build a node for each value. PyYAML's
    nodes took 71 MB of memory for 140,000 values, and made reading four times as slow (PyYAML 6, libyaml).
    """
    events = yaml_events(data)
    try:
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                yield _build_document(events)
    except YamlError as error:
        raise TrajectoryError(error.message, error.line or None, error.column or None) from error


def _build_document(events: Iterator[yaml.Event]) -> object:
    roots: list[object] = []
    # each unfinished list or dictionary, and the dictionary key that still needs a value
    open_nodes: list[tuple[Any, list[str]]] = [(roots, [])]
    anchors: dict[str, object] = {}
    values = 0
    for event in events:
        if isinstance(event, yaml.DocumentEndEvent):
            break
        if isinstance(event, yaml.CollectionEndEvent):
            open_nodes.pop()
            continue
        assert isinstance(event, yaml.NodeEvent)
        line = event.start_mark.line + 1 if event.start_mark else None
        node: object = {} if isinstance(event, yaml.MappingStartEvent) else []
        if isinstance(event, yaml.ScalarEvent):
            node = event.value
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in anchors:
                raise TrajectoryError(Message("yaml.unknown-anchor", anchor=str(event.anchor)), line)
            node = anchors[event.anchor]
        elif event.anchor:
            anchors[event.anchor] = node
        values += 1
        if values > MAX_VALUES:
            raise TrajectoryError(TOO_MANY_VALUES, line)
        parent, key = open_nodes[-1]
        if isinstance(parent, list):
            parent.append(node)
        elif key:
            parent[key.pop()] = node
        else:
            key.append(node if isinstance(node, str) else "?")
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((node, []))
    return roots[0] if roots else None
