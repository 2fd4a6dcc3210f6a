"""Rules about set points beyond an axis's limits, and about first set points far from the robot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from bcapscope.analysis.call_arguments import argument
from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place, client_place
from bcapscope.analysis.rules.rule_checker import NO_REASON, Occurrence, Refusal, RefusalReason, RuleChecker
from bcapscope.analysis.slave.motion_model import Jump, MotionFacts
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Duration, FramePlace, Moment, Quantity
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType, pose_type_of_mode
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.protocol.slave_mode.slvmove_values import parse_set_point
from bcapscope.protocol.tables.hresult import describe_hresult, with_rc7_forms
from bcapscope.traffic.call import Call

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
_INVALID_CODES = with_rc7_forms((0x83201405, 0x84201547, 0x80201548, 0x8420151C, 0x83201401))

_FAR_DISTANCE = 1.0


class LimitChecker(RuleChecker):
    def session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        motion = session.motion
        if motion is None:
            return
        if motion.not_finite:
            yield _not_finite(session, motion)
        distances = [abs(each) if math.isfinite(each) else 0.0 for each in motion.first_distance]
        named = list(zip(motion.axes, distances, strict=False))
        measured = [(axis, distance) for axis, distance in named if axis.unit]
        if measured:
            axis, distance = max(measured, key=lambda pair: pair[1])
            if distance > _FAR_DISTANCE and not session.began_before_capture:
                yield _far_first_point(session, motion, axis.name, Quantity(distance, axis.unit))
        units = {axis.name: axis.unit for axis in motion.axes}
        for jump in motion.jump_list:
            yield _set_point_jump(session, jump, units.get(jump.axis, ""))


def _not_finite(session: SlaveSession, motion: MotionFacts) -> Occurrence:
    time, frames = _first_time(session), motion.not_finite_frames
    fact = Message(
        "finding.not-finite",
        client=client_place(session.conversation),
        points=Count(motion.not_finite, "set-point"),
        frame=FramePlace(frames[:1]),
    )
    return Occurrence("not-finite", time, time, session.conversation, frames[:8], fact)


def _far_first_point(session: SlaveSession, motion: MotionFacts, axis: str, distance: Quantity) -> Occurrence:
    time = _first_time(session)
    fact = Message(
        "finding.far-first-point",
        client=client_place(session.conversation),
        distance=distance,
        axis=axis,
        known_by=motion.first_distance_known_by or "",
    )
    clause = Message("clause.far-first-point", distance=distance, axis=axis)
    frames = motion.first_distance_frames
    return Occurrence("far-first-point", time, time, session.conversation, frames, fact, clause)


def _set_point_jump(session: SlaveSession, jump: Jump, unit: str) -> Occurrence:
    step, speed = Quantity(jump.step, unit), abs(jump.step) / (session.timing.grid_ms / 1000)
    fact = Message(
        f"finding.set-point-jump.{jump.kind.value}",
        at=Moment(jump.time),
        frame=FramePlace((jump.frame,)),
        step=step,
        axis=jump.axis,
        speed=Quantity(speed, f"{unit}/s"),
    )
    clause = Message("clause.set-point-jump", step=step, axis=jump.axis)
    return Occurrence(
        "set-point-jump", jump.time, jump.time, session.conversation, (jump.frame,), fact, clause
    )


def _first_time(session: SlaveSession) -> int:
    return session.entered_at if session.first_set_point is None else session.first_set_point.time


def _pose_type(client: ClientState) -> PoseType | None:
    return pose_type_of_mode(client.mode_value) if client.mode_value else None


def _pose_values(call: Call, pose_type: PoseType | None) -> tuple[float, ...]:
    parameter = argument(call, 2)
    if parameter is None or call.kind.folded_command != "slvmove":
        return ()
    pose = parse_set_point(parameter, pose_type).pose
    return pose.values if pose is not None else ()


def _explain_over_limit(call: Call, client: ClientState) -> RefusalReason | None:
    axis = describe_hresult(call.hresult or 0).axis
    pose_type = _pose_type(client)
    points = [*client.recent_set_points, call]
    poses = [_pose_values(point, pose_type) for point in points]
    if axis is None:
        return RefusalReason(clause=Message("clause.over-limit"))
    key, clause = f"J{axis}", Message("clause.over-limit.axis", axis=axis)
    worst = _worst_step(poses, axis - 1) if pose_type in (PoseType.J, None) else None
    if worst is None:
        return RefusalReason(clause=clause, group_key=key)
    index, step = worst
    before, after = points[index], points[index + 1]
    reason = Message(
        "reason.over-limit",
        axis=axis,
        points=Count(len(points), "set-point"),
        step=Quantity(step, "deg"),
        before=call_place(before),
        after=call_place(after),
        at=Moment(after.request.time),
        speed=Quantity(abs(step) * 1000 / PERIOD_MS, "deg/s"),
        period=Quantity(PERIOD_MS, "ms"),
        interval=Duration(after.request.time - before.request.time),
    )
    return RefusalReason(reason, clause=clause, evidence_call=after, group_key=key)


def _worst_step(poses: Sequence[tuple[float, ...]], axis: int) -> tuple[int, float] | None:
    steps = [
        (index, after[axis] - before[axis])
        for index, (before, after) in enumerate(pairwise(poses))
        if len(before) > axis and len(after) > axis
    ]
    finite = [each for each in steps if math.isfinite(each[1])]
    return max(finite, key=lambda each: abs(each[1])) if finite else None


def _explain_beyond_range(call: Call, client: ClientState) -> RefusalReason | None:
    axis = describe_hresult(call.hresult or 0).axis
    pose_type = _pose_type(client)
    pose = _pose_values(call, pose_type)
    key = "" if axis is None else f"J{axis}"
    if axis is None or pose_type not in (PoseType.J, None) or len(pose) < axis:
        return RefusalReason(group_key=key)
    # Round to 6 significant digits, because a single-precision number has only 6 exact digits.
    value = float(f"{pose[axis - 1]:.6g}")
    reason = Message("reason.beyond-range", axis=AXES[PoseType.J][axis - 1].name, value=value)
    return RefusalReason(reason, group_key=key)


def _explain_invalid(call: Call, client: ClientState) -> RefusalReason | None:
    parameter = argument(call, 2)
    if parameter is None or call.kind.folded_command != "slvmove":
        return NO_REASON
    problems = parse_set_point(parameter, _pose_type(client)).problems
    return RefusalReason(problems[0]) if problems else NO_REASON


REFUSALS: tuple[Refusal, ...] = (
    Refusal("over-limit", _SPEED_CODES, _explain_over_limit),
    Refusal("beyond-range", _RANGE_CODES, _explain_beyond_range),
    Refusal("invalid-set-point", _INVALID_CODES, _explain_invalid),
)
