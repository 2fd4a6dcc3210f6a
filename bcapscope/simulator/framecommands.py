"""Commands of Robot_Execute that compute with poses, tools and works, and the extension Pallet.

Parameters and results: ShoheiKobata/orin_bcap_python_samples (Dev, DevH, CheckVirtualFence, Pallet), and
DENSO's descriptions of Dev, DevH, OutRange, GetToolDef and SetToolDef quoted in
nkawa/Denso_CobottaPro900_MQTT_Control. Definitions of tools and works are kept and returned. They do not
change the position that the simulated arm returns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from bcapscope.protocol.hresult import E_ARM_NOT_TAKEN, E_INVALIDARG
from bcapscope.protocol.poses import AXES
from bcapscope.protocol.slavemode import PoseType
from bcapscope.protocol.variant import Variant
from bcapscope.simulator.context import Command, Commands, Context
from bcapscope.simulator.equipment import MOST_FRAMES, Frame
from bcapscope.simulator.frames import PosePart, moved_in_base, moved_in_tool, seen_from
from bcapscope.simulator.kinematics import FIG, Joints, beyond_limit, joints_of, pose_of
from bcapscope.simulator.outcome import DONE, Answer, Outcome, RefusedError
from bcapscope.simulator.posenotation import WrittenPose, parse_pose, parse_target
from bcapscope.simulator.refusals import BAD_INDEX
from bcapscope.simulator.values import i4, integer_of, items_of, nth, number_of, numbers_of, row

_P, _J, _T = PoseType.P, PoseType.J, PoseType.T
NOWHERE: Frame = (0.0,) * 6
"""A tool or work that was never defined."""

_UNREACHABLE = -1
_MOST_PLACES = 32767
"""Rows, columns and layers of a pallet; assumed."""


def _convert(from_type: PoseType, to_type: PoseType) -> Command:
    def run(context: Context, parameter: Variant) -> Outcome:
        return Answer(
            value=row(context.machine.profile.real, pose_of(to_type, _joints(context, from_type, parameter)))
        )

    return run


def _joints(context: Context, pose_type: PoseType, parameter: Variant) -> Joints:
    """Read a pose whose type the command says where the notation does not."""
    items = items_of(parameter)
    if len(items) >= len(AXES[_P]) - 1 and all(isinstance(item.value, int | float) for item in items):
        return joints_of(pose_type, numbers_of(parameter)[: len(AXES[pose_type])])
    return parse_target(parameter, context.machine.memory.read).joints


def out_range(context: Context, parameter: Variant) -> Outcome:
    """Run OutRange: 0 inside, bits of the axes beyond their limits, -1 unreachable."""
    items = items_of(parameter)
    pose = items[0] if items and not isinstance(items[0].value, int | float) else parameter
    try:
        joints = parse_target(pose, context.machine.memory.read).joints
    except RefusedError as refusal:
        if refusal.hresult == E_INVALIDARG:
            raise
        return Answer(value=i4(_UNREACHABLE))
    axis = beyond_limit(joints, context.machine.start.limits)
    return Answer(value=i4(1 << axis - 1 if axis else 0))


def check_virtual_fence(context: Context, parameter: Variant) -> Outcome:
    """Run CheckVirtualFence: 0, as the simulated robot has no fences."""
    _written(context, parameter)
    return Answer(value=i4(0))


def _moved(move: Callable[[PosePart, PosePart], PosePart]) -> Command:
    def run(context: Context, parameter: Variant) -> Outcome:
        items = items_of(parameter)
        if len(items) != 2:
            raise RefusedError(E_INVALIDARG)
        base, deviation = (_position(context, item) for item in items)
        return Answer(value=row(context.machine.profile.real, (*move(base, deviation), _fig(base))))

    return run


def convert_work(context: Context, parameter: Variant) -> Outcome:
    """Run ConvertPosWork: a pose of one work as another work sees it."""
    items = items_of(parameter)
    pose = _position(context, nth(items, 0))
    works = context.machine.equipment.works
    source, target = (works.get(frame_number(integer_of(nth(items, index))), NOWHERE) for index in (1, 2))
    values = seen_from(target, moved_in_tool(source, pose))
    return Answer(value=row(context.machine.profile.real, (*values, _fig(pose))))


def tool_definition(context: Context, parameter: Variant) -> Outcome:
    """Run GetToolDef."""
    tools = context.machine.equipment.tools
    return Answer(
        value=row(context.machine.profile.real, tools.get(frame_number(integer_of(parameter)), NOWHERE))
    )


def _define(frames: Callable[[Context], dict[int, Frame]]) -> Command:
    def run(context: Context, parameter: Variant) -> Outcome:
        items, machine = items_of(parameter), context.machine
        if machine.profile.needs_arm and machine.owner != context.client:
            raise RefusedError(E_ARM_NOT_TAKEN)
        number = frame_number(integer_of(nth(items, 0)), first=1)
        frames(context)[number] = _position(context, nth(items, 1))[:6]
        return DONE

    return run


def frame_number(number: int, first: int = 0) -> int:
    """Return the number of a tool or work.

    Raises:
        RefusedError: it is below `first` or too large.
    """
    if not first <= number < MOST_FRAMES:
        raise RefusedError(BAD_INDEX)
    return number


def _written(context: Context, pose: Variant) -> WrittenPose:
    return parse_pose(pose, context.machine.memory.read)


def _position(context: Context, pose: Variant) -> PosePart:
    """Read a pose of any type as P type; one that is of P type need not be within reach."""
    written = _written(context, pose)
    return written.values if written.type is _P else pose_of(_P, joints_of(written.type, written.values))


def _fig(pose: PosePart) -> float:
    return pose[6] if len(pose) > 6 else FIG


def pallet_place(context: Context, parameter: Variant) -> Outcome:
    """Run CalcPos of the extension Pallet.

    The parameter holds rows, columns, height of a layer [mm], the four corners, the number of the place and,
    if there is one, that of the layer, both from 1. Places are counted from the first corner to the second,
    row by row to the third; the samples do not say so.
    """
    items = items_of(parameter)
    rows, columns = (_count(nth(items, index)) for index in (0, 1))
    height = float(number_of(nth(items, 2)))
    corners = [_position(context, nth(items, index)) for index in (3, 4, 5, 6)]
    place = _count(nth(items, 7)) - 1
    layer = _count(items[8]) - 1 if len(items) > 8 else 0
    if place >= rows * columns:
        raise RefusedError(BAD_INDEX)
    down, across = _share(place // columns, rows), _share(place % columns, columns)
    near = _between(corners[0], corners[1], across)
    far = _between(corners[2], corners[3], across)
    x, y, z = _between(near, far, down)
    first = corners[0]
    values = (x, y, z + height * layer, *first[3:6], _fig(first))
    return Answer(value=row(context.machine.profile.real, values))


def _count(part: Variant) -> int:
    number = integer_of(part)
    if not 1 <= number <= _MOST_PLACES:
        raise RefusedError(E_INVALIDARG)
    return number


def _share(index: int, count: int) -> float:
    return index / (count - 1) if count > 1 else 0.0


def _between(one: PosePart, other: PosePart, share: float) -> PosePart:
    return tuple(a + (b - a) * share for a, b in zip(one[:3], other[:3], strict=True))


FRAME_COMMANDS: Commands = MappingProxyType(
    {
        "j2p": _convert(_J, _P),
        "j2t": _convert(_J, _T),
        "p2j": _convert(_P, _J),
        "p2t": _convert(_P, _T),
        "t2j": _convert(_T, _J),
        "t2p": _convert(_T, _P),
        "outrange": out_range,
        "checkvirtualfence": check_virtual_fence,
        "dev": _moved(moved_in_base),
        "devh": _moved(moved_in_tool),
        "convertposwork": convert_work,
        "gettooldef": tool_definition,
        "settooldef": _define(lambda context: context.machine.equipment.tools),
        "setworkdef": _define(lambda context: context.machine.equipment.works),
    }
)
"""Commands of Robot_Execute by their names in lower case."""

PALLET_COMMANDS: Mapping[str, Command] = MappingProxyType({"calcpos": pallet_place})
"""Commands of the extension Pallet by their names in lower case."""
