"""Set points that ask too much of an axis, or begin somewhere else than the robot is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from bcapscope.analysis.client import Client, Clients, argument, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.motion import Jump, JumpKind
from bcapscope.analysis.rules.refusal import NO_MORE, Refusal, Why, fixed, refusal
from bcapscope.analysis.rules.rule import Incident, Rule, Watcher
from bcapscope.analysis.speech import Speech, amount, called, span
from bcapscope.analysis.stay import Stay
from bcapscope.protocol.hresult import describe
from bcapscope.protocol.poses import AXES
from bcapscope.protocol.setpoints import split_set_point
from bcapscope.protocol.slavemode import PoseType, mode_pose_type
from bcapscope.protocol.wording import counted
from bcapscope.traffic.exchange import Exchange

_ERRORS = "public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
_SEED = "DENSO Wave 2009, How to use the Slave mode"

OVER_LIMIT = Rule(
    "over-limit",
    Severity.ERROR,
    "an axis was commanded too fast or accelerated too hard (842040xx and the like)",
    "Look at the set points named: a jump, a wrong unit (radians), a first point away from the robot, or two "
    "periods of motion in one after a pause; smooth start and stop, and keep steps per 8 ms inside the "
    "axis's limits.",
    f"DENSORobot/denso_robot_ros issues 19 and 48; DENSORobot/denso_robot_ros2 issue 17; {_ERRORS}",
    ("set-point-jump", "far-first-point", "not-finite", "set-point-gap", "off-grid", "slow-retry"),
)
BEYOND = Rule(
    "beyond-range",
    Severity.ERROR,
    "an axis was commanded beyond its software limit or range",
    "Keep the set points inside the axis's range; check units (degrees, mm) and the order of the axes.",
    _ERRORS,
    ("set-point-jump", "far-first-point", "not-finite"),
)
INVALID = Rule(
    "invalid-set-point",
    Severity.ERROR,
    "a set point is refused as not valid",
    "Check the number of elements against the mode (P 7, J 8, T 10), the figure, and for values "
    "that are no number.",
    f"{_ERRORS}; DENSORobot/denso_robot_ros2 denso_robot_core",
    ("not-finite", "unusual-argument", "set-point-jump"),
)
NOT_FINITE = Rule(
    "not-finite",
    Severity.ERROR,
    "a set point holds a NaN or an infinity",
    "Stop the trajectory generator on such values: nothing after them can be trusted.",
    "IEEE 754; DENSORobot/denso_robot_ros2 denso_robot_control",
)
FAR = Rule(
    "far-first-point",
    Severity.WARNING,
    "the first set point of a stay is away from where the robot was",
    "Move the robot to the first position (Robot_Move with @E) before slvChangeMode, or begin the trajectory "
    "at the pose that the robot returns.",
    f"{_SEED}, Starting your client app.",
)
JUMP = Rule(
    "set-point-jump",
    Severity.NOTE,
    "one step between set points is far larger than those around it, or than any axis follows",
    "Look for a missing piece of trajectory at this frame, a wrap of an angle at 180 degrees, or two sources "
    "of set points.",
    "DENSORobot/denso_robot_ros issues 19 and 48; denso_cobotta_ros issue 14",
)

_SPEED_FAMILIES = tuple(
    range(base, base + 0x10)
    for base in (
        *(0x82204020, 0x84204040, 0x84204050, 0x84204060, 0x84204080, 0x84204090, 0x842040A0, 0x84204250),
        *(0x84204310, 0x84204370, 0x84404500, 0x84404510, 0x84404520),
    )
)
_SPEED_CODES = frozenset(code for family in _SPEED_FAMILIES for code in family) | {0x84201414, 0x84201415}
_RANGE_BASES = (0x83204070, 0x83204230, 0x82204240, 0x81204120, 0x83404D10)
_RANGE_CODES = frozenset(base + axis for base in _RANGE_BASES for axis in range(1, 9))
_INVALID_CODES = (0x83201405, 0x84201547, 0x80201548, 0x8420151C, 0x83201401)

_BESIDE = {
    JumpKind.ALONE: "far more than those around it",
    JumpKind.STRAY: "far more than those around it, and the next one turns back",
    JumpKind.ABSURD: "more than any axis follows",
}
_PERIOD_S = 0.008
_FAR = 1.0


class Limits(Watcher):
    """Looks at where set points lead."""

    rules = (OVER_LIMIT, BEYOND, INVALID, NOT_FINITE, FAR, JUMP)

    def stay(self, stay: Stay) -> None:
        motion = stay.motion
        if motion is None:
            return
        if motion.not_finite:
            self._not_finite(stay, motion.not_finite, motion.not_finite_frames)
        distances = [abs(each) if math.isfinite(each) else 0.0 for each in motion.first_distance]
        named = list(zip(motion.axes, distances, strict=False))
        measured = [(axis, distance) for axis, distance in named if axis.unit]
        if measured:
            axis, distance = max(measured, key=lambda pair: pair[1])
            if distance > _FAR and not stay.began_before_capture:
                self._far(stay, axis.name, axis.unit, distance)
        for jump in motion.jump_list:
            self._jump(stay, jump)

    def _not_finite(self, stay: Stay, count: int, frames: tuple[int, ...]) -> None:
        def say(speech: Speech) -> str:
            who = speech.client(stay.conversation)
            return (
                f"{who} sent {counted(count, 'set point')} with a NaN or an infinity, the first in "
                f"frame {frames[0]}"
            )

        time = stay.first.time if stay.first is not None else stay.entered
        self.report(Incident(NOT_FINITE, time, time, stay.conversation, frames[:8], say))

    def _far(self, stay: Stay, axis: str, unit: str, distance: float) -> None:
        known_by = stay.motion.first_distance_known_by if stay.motion is not None else ""
        frames = stay.motion.first_distance_frames if stay.motion is not None else ()

        def say(speech: Speech) -> str:
            who = speech.client(stay.conversation)
            return (
                f"the first set point of {who} is {amount(distance)} {unit} away in {axis} from where the "
                f"robot was ({known_by}), and in slave mode it is to get there in one period"
            )

        def then(speech: Speech, after: int) -> str:
            return f"the first set point was {amount(distance)} {unit} away in {axis}"

        time = stay.first.time if stay.first is not None else stay.entered
        self.report(Incident(FAR, time, time, stay.conversation, frames, say, then))

    def _jump(self, stay: Stay, jump: Jump) -> None:
        unit = (
            next((axis.unit for axis in stay.motion.axes if axis.name == jump.axis), "")
            if stay.motion
            else ""
        )
        speed = abs(jump.step) / (stay.timing.grid_ms / 1000)

        def say(speech: Speech) -> str:
            return (
                f"at {speech.at(jump.time)} the set point of frame {jump.frame} jumps by {amount(jump.step)} "
                f"{unit} in {jump.axis} ({amount(speed)} {unit}/s in one period), {_BESIDE[jump.kind]}"
            )

        def then(speech: Speech, after: int) -> str:
            return f"a set point jumped by {amount(jump.step)} {unit} in {jump.axis}"

        self.report(Incident(JUMP, jump.time, jump.time, stay.conversation, (jump.frame,), say, then))


def _pose(call: Exchange, pose_type: PoseType | None) -> tuple[float, ...]:
    parameter = argument(call, 2)
    if parameter is None or command_of(call.question) != "slvmove":
        return ()
    pose = split_set_point(parameter, pose_type).pose
    return pose.values if pose is not None else ()


def _over_limit(call: Exchange, client: Client, clients: Clients) -> Why | None:
    axis = describe(call.hresult or 0).axis
    pose_type = mode_pose_type(client.mode) if client.mode else None
    points = [*client.points, call]
    poses = [_pose(point, pose_type) for point in points]
    key = "" if axis is None else f"J{axis}"
    clause = f"an axis{f' (J{axis})' if axis else ''} was commanded too fast"
    if axis is None or pose_type not in (PoseType.J, None):
        return Why(then=lambda speech, after: clause, key=key)
    worst = _worst_step(poses, axis - 1)
    if worst is None:
        return Why(then=lambda speech, after: clause, key=key)
    index, step = worst
    speed = abs(step) / _PERIOD_S
    before, after_it = points[index], points[index + 1]
    interval = after_it.request.time - before.request.time

    def text(speech: Speech) -> str:
        return (
            f"the largest step of J{axis} in the {counted(len(points), 'set point')} up to then is "
            f"{amount(step)} deg, from {called(before)} to {called(after_it)} at "
            f"{speech.at(after_it.request.time)} ({amount(speed)} deg/s if taken in one period of 8 ms; they "
            f"were sent {span(interval)} apart)"
        )

    return Why(text, then=lambda speech, after: clause, before=after_it, key=key)


def _worst_step(poses: Sequence[tuple[float, ...]], axis: int) -> tuple[int, float] | None:
    steps = [
        (index, after[axis] - before[axis])
        for index, (before, after) in enumerate(pairwise(poses))
        if len(before) > axis and len(after) > axis
    ]
    finite = [each for each in steps if math.isfinite(each[1])]
    return max(finite, key=lambda each: abs(each[1])) if finite else None


def _beyond(call: Exchange, client: Client, clients: Clients) -> Why | None:
    axis = describe(call.hresult or 0).axis
    pose_type = mode_pose_type(client.mode) if client.mode else None
    pose = _pose(call, pose_type)
    key = "" if axis is None else f"J{axis}"
    if axis is None or pose_type not in (PoseType.J, None) or len(pose) < axis:
        return Why(key=key)
    return Why(
        lambda speech: f"the set point asks for {AXES[PoseType.J][axis - 1].name} = {pose[axis - 1]:.6g}",
        key=key,
    )


def _invalid(call: Exchange, client: Client, clients: Clients) -> Why | None:
    parameter = argument(call, 2)
    if parameter is None or command_of(call.question) != "slvmove":
        return NO_MORE
    problems = split_set_point(parameter, mode_pose_type(client.mode) if client.mode else None).problems
    return fixed(problems[0]) if problems else NO_MORE


REFUSALS: tuple[Refusal, ...] = (
    refusal(OVER_LIMIT, _SPEED_CODES, _over_limit),
    refusal(BEYOND, _RANGE_CODES, _beyond),
    refusal(INVALID, _INVALID_CODES, _invalid),
)
