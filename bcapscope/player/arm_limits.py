"""Limits of an arm for each axis, and the speed and acceleration of set points relative to these limits.

The type name that the controller reports identifies the arm. No public document lists the limits of all arms,
so bcapscope knows only the limits of the simulator's arm. The user gives the limits of a real arm.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TypeAlias

import numpy as np

from bcapscope.errors import BcapError, InputError
from bcapscope.messages import Message
from bcapscope.player.smooth_curve import Array, unwrap_rotations
from bcapscope.protocol.number_parsing import parse_number
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, Axis
from bcapscope.protocol.text_format import shortened
from bcapscope.simulator.kinematics import AXIS_COUNT, AXIS_LIMITS, AxisLimit, joints_of
from bcapscope.simulator.machine import ROBOT_TYPE

ToJoints: TypeAlias = Callable[[PoseType, tuple[float, ...]], tuple[float, ...]]

MAX_ARM_SPEED = {"deg": 1500.0, "mm": 15_000.0}
"""Speed in deg/s or mm/s that no arm of DENSO Wave exceeds. This speed replaces an unknown speed limit."""

_NAMES = tuple(dict.fromkeys(axis.name for kind in AXES.values() for axis in kind if axis.unit))
_UNLIMITED = AxisLimit(-inf, inf, inf, inf)
MAX_LIMIT = 1e9
"""Largest number that a user may set as a limit, in any unit. The limits of real robots are far below this
number.
"""

_LIMIT = re.compile(
    r"\s*(?P<first>\w+)(?:\.\.(?P<last>\w+))?(?:\.(?P<what>speed|acceleration))?\s*=\s*(?P<value>.+)"
)
_EXAMPLES = "J1=-170..170, J1.speed=300, J1..J3.acceleration=6000"


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Limits of one arm. An unknown limit is infinite; an unknown `to_joints` or `axis_count` is None.

    Attributes:
        axes: Limits by axis name, in degrees or mm, per second (speed) or second squared (acceleration).
        to_joints: Computes the joints for a pose of P or T type; raises BcapError if this is impossible.
    """

    arm_name: Message
    axes: Mapping[str, AxisLimit] = field(default_factory=dict)
    to_joints: ToJoints | None = None
    axis_count: int | None = None

    def known_limit(self, name: str) -> AxisLimit:
        return self.axes.get(name, _UNLIMITED)

    def limit_for(self, name: str, unit: str) -> AxisLimit:
        """Return the limits that apply to an axis; `MAX_ARM_SPEED` replaces an unknown speed limit."""
        known = self.known_limit(name)
        return known if known.speed < inf else known._replace(speed=MAX_ARM_SPEED.get(unit, inf))


UNKNOWN_ARM = ArmLimits(Message("arm.unknown"))

SIMULATED_ARM = ArmLimits(
    Message("arm.simulated"),
    {axis.name: limit for axis, limit in zip(AXES[PoseType.J], AXIS_LIMITS, strict=False)},
    joints_of,
    AXIS_COUNT,
)
"""A scenario can set narrower software limits, which the simulator does not report to clients."""


def limits_for_arm(type_name: str) -> ArmLimits:
    return SIMULATED_ARM if type_name == ROBOT_TYPE else UNKNOWN_ARM


def with_limits(limits: ArmLimits, texts: Sequence[str]) -> ArmLimits:
    """Return a copy of `limits` with the new values from `texts`. Raises InputError if a text is invalid.

    Each text is `AXES=LOW..HIGH`, `AXES.speed=NUMBER` or `AXES.acceleration=NUMBER`. Distances are in mm,
    angles in degrees and times in seconds. AXES is a name such as `J1` or `X`, or a range such as `J1..J3`.
    """
    axes = dict(limits.axes)
    for typed in texts:
        found, text = _LIMIT.fullmatch(typed), shortened(typed, 60)
        if not found:
            raise InputError(Message("limit.invalid", text=text, examples=_EXAMPLES))
        change = _parse_change(text, found["what"], found["value"])
        for name in _axis_range(text, found["first"], found["last"] or found["first"]):
            axes[name] = axes.get(name, _UNLIMITED)._replace(**change)
    return replace(limits, axes=axes)


def _parse_change(text: str, what: str | None, value: str) -> dict[str, float]:
    low, dots, high = value.partition("..")
    read = [parse_number(each, -MAX_LIMIT, MAX_LIMIT) for each in ((low, high) if dots else (low,))]
    numbers = [number for number in read if number is not None]
    if len(numbers) != len(read) or len(numbers) != (1 if what else 2):
        case = "limit.not-a-number" if what else "limit.not-a-range"
        raise InputError(Message(case, text=text, value=shortened(value, 40), examples=_EXAMPLES))
    if what:
        if numbers[0] <= 0:
            raise InputError(Message("limit.not-positive", text=text, what=what))
        return {what: numbers[0]}
    if numbers[0] >= numbers[1]:
        raise InputError(Message("limit.empty-range", text=text, low=low, high=high))
    return {"low": numbers[0], "high": numbers[1]}


def _axis_range(text: str, first: str, last: str) -> tuple[str, ...]:
    names = [name.casefold() for name in _NAMES]
    try:
        start, stop = names.index(first.casefold()), names.index(last.casefold())
    except ValueError:
        raise InputError(Message("limit.no-axis", text=text, axes=", ".join(_NAMES))) from None
    if stop < start:
        raise InputError(Message("limit.axis-order", text=text, first=first, last=last))
    return _NAMES[start : stop + 1]


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryMotion:
    """The motion of some axes in mm or degrees. `rows` has one row per set point, every `period` seconds. If
    the arm cannot reach a set point, all values of its row are NaN. Angles continue beyond 180° instead of
    jumping to -180°.
    """

    axes: tuple[Axis, ...]
    rows: Array
    period: float

    @property
    def speeds(self) -> Array:
        """Speed between neighbouring set points, in units per second; one row per step."""
        return np.diff(self.rows, axis=0) / self.period

    @property
    def accelerations(self) -> Array:
        """Acceleration in units per second squared, computed from three set points, as controllers do."""
        return np.diff(self.rows, n=2, axis=0) / (self.period * self.period)  # ** may raise an exception


def motions_of(kind: PoseType, points: Array, period: float, limits: ArmLimits) -> Iterator[TrajectoryMotion]:
    """Yield the motion of the pose's axes that have a unit. For type P or T, then also yield the motion of
    the joints if `limits.to_joints` is known.
    """
    axes = AXES[kind][: points.shape[1]]
    counted = [place for place, axis in enumerate(axes) if axis.unit]
    yield TrajectoryMotion(
        tuple(axes[place] for place in counted), unwrap_rotations(kind, points)[:, counted], period
    )
    if kind is not PoseType.J and limits.to_joints is not None:
        known = [axis for axis in AXES[PoseType.J] if axis.name in limits.axes]
        yield TrajectoryMotion(tuple(known), _joints(kind, points, limits.to_joints)[:, : len(known)], period)


def _joints(kind: PoseType, points: Array, to_joints: ToJoints) -> Array:
    rows = np.full((len(points), len(AXES[PoseType.J])), np.nan)
    for place in np.flatnonzero(np.isfinite(points).all(axis=1)).tolist():
        try:
            rows[place] = to_joints(kind, tuple(points[place].tolist()))
        except BcapError:
            continue  # the arm cannot reach the set point; its row stays NaN
    return rows


def limit_excess(kind: PoseType, points: Array, period: float, limits: ArmLimits) -> float:
    """Return the largest ratio of speed or acceleration to its limit; infinity if a point is out of reach."""
    worst = 0.0
    for motion in motions_of(kind, points, period, limits):
        known = [limits.limit_for(axis.name, axis.unit) for axis in motion.axes]
        shares = (
            np.abs(motion.speeds) / np.array([limit.speed for limit in known]),
            np.abs(motion.accelerations) / np.array([limit.acceleration for limit in known]),
        )
        found = max((float(share.max()) for share in shares if share.size), default=0.0)
        worst = max(worst, np.inf if np.isnan(found) else found)
    return worst
