"""Trajectories to play: smooth, at rest at both ends, well within what the simulated arm can do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

CYCLE = 0.008

_HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)
_SWING = (40.0, 25.0, 30.0, -45.0, -30.0, 90.0, 0.0, 0.0)
_SECONDS = 4.0
_CENTRE, _RADIUS = (420.0, 0.0, 560.0), 90.0
_LAG = 3  # records that the encoders are behind
_BOOT = 120_000  # ms from switching on to the first record


def joints() -> bytes:
    """Return joints that swing out and back, as bcapscope's own CSV."""
    head = ("time_s", *(f"J{axis}_deg" for axis in range(1, 9)))
    return _csv(head, ((time, *_swung(time)) for time in _times(_SECONDS)))


def positions() -> bytes:
    """Return half a circle in the air, there and back, as positions."""
    head = ("time_s", "X_mm", "Y_mm", "Z_mm", "Rx_deg", "Ry_deg", "Rz_deg", "Fig")
    return _csv(head, ((time, *_on_circle(time / _SECONDS)) for time in _times(_SECONDS)))


def control_log() -> bytes:
    """Return the same joints as a controller's log: Shift-JIS, 39 columns, a counter in ms."""
    what = ("指令値", "エンコーダ値", "電流値", "負荷率")
    rest = (
        "ユーザデータ",
        "プログラム管理番号",
        "ファイル名",
        "行番号",
        "コントローラ起動時からのカウンタ",
        "ツール番号",
        "ワーク番号",
    )
    head = (*(f"J{axis} - {each}" for axis in range(1, 9) for each in what), *rest)
    lines = [",".join(f"[{title}]" for title in head)]
    times = list(_times(2.0))
    for place, time in enumerate(times):
        asked, shown = _swung(time * 2), _swung(times[max(place - _LAG, 0)] * 2)
        cells: list[object] = []
        for a, b in zip(asked, shown, strict=True):
            ampere = round((a - b) * 0.25, 3)
            cells += [a, b, ampere, abs(ampere) * 10]
        cells += [0, 0, "pro1.pcs", 12, _BOOT + place * 8, 0, 0]
        lines.append(",".join(f"{cell:g}" if isinstance(cell, float) else str(cell) for cell in cells))
    return "\n".join((*lines, "")).encode("cp932")


def joint_trajectory() -> bytes:
    """Return the way-points of a JointTrajectory of ROS 2 as YAML: radians, not evenly timed."""
    names = [f"joint_{number}" for number in (2, 1, 3, 4, 5, 6)]
    points = (
        (0, 0, (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)),
        (0, 600_000_000, (0.1, 0.15, 1.65, -0.1, 1.5, 0.2)),
        (1, 400_000_000, (0.3, 0.5, 1.8, -0.4, 1.2, 0.7)),
        (2, 0, (0.32, 0.6, 1.82, -0.45, 1.15, 0.8)),
        (3, 500_000_000, (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)),
    )
    lines = ["joint_names:", *(f"- {name}" for name in names), "points:"]
    for seconds, nanoseconds, row in points:
        lines.append(f"- positions: [{', '.join(map(str, row))}]")
        lines += ["  time_from_start:", f"    sec: {seconds}", f"    nanosec: {nanoseconds}"]
    return "\n".join((*lines, "")).encode()


def _times(seconds: float) -> Iterator[float]:
    return (cycle * CYCLE for cycle in range(round(seconds / CYCLE) + 1))


def _csv(head: Sequence[str], rows: Iterator[tuple[float, ...]]) -> bytes:
    lines = (f"{row[0]:.9f}," + ",".join(f"{value:g}" for value in row[1:]) for row in rows)
    return "\n".join((",".join(head), *lines, "")).encode()


def _smooth(part: float) -> float:
    """Go from 0 to 1 while `part` does, at rest at both ends."""
    part = min(max(part, 0.0), 1.0)
    return part * part * part * (10.0 - part * (15.0 - 6.0 * part))


def _there_and_back(part: float) -> float:
    return _smooth(part * 2) - _smooth(part * 2 - 1)


def _swung(time: float) -> tuple[float, ...]:
    """Return the joints, each of which sets out a little after the one before and takes three quarters."""
    swings = enumerate(zip(_HOME, _SWING, strict=True))
    parts = [(time / _SECONDS - 0.05 * min(axis, 5)) / 0.75 for axis in range(8)]
    return tuple(round(home + swing * _there_and_back(parts[axis]), 3) for axis, (home, swing) in swings)


def _on_circle(part: float) -> tuple[float, ...]:
    """Return a point of the half circle above its centre, by a formula without sine and cosine."""
    u = 2.0 * _there_and_back(part) - 1.0
    across, up = _RADIUS * 2 * u / (1 + u * u), _RADIUS * (1 - u * u) / (1 + u * u)
    x, y, z = _CENTRE
    turn = 20.0 * u
    return (
        round(x + 0.2 * across, 3),
        round(y + across, 3),
        round(z + up, 3),
        0.0,
        90.0,
        round(turn, 3),
        1.0,
    )
