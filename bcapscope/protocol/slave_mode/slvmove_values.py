"""Decode the set point in slvMove's parameter, and the robot's feedback in slvMove's result.

Sources: DENSO Wave 2009, How to use the Slave mode, for values that are only a pose;
DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_robot.cpp for the order of elements. The client selects
the elements of both with slvSendFormat and slvRecvFormat. If the capture lacks these commands, the decoder
guesses the meaning of the elements from their number and kinds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple, TypeAlias

from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.formats import POSE_ONLY_FORMAT, ReceiveFormat, SendFormat
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, FLOAT_ARRAYS, Pose, build_pose, pose_numbers

# Kinds of elements in slvMove's parameter and result. The decoder uses the kinds to guess the meanings of the
# elements.
_ROW, _WORD, _DATA, _OTHER, _END = "numbers", "integer", "bytes", "other", "end"

_Arrangement: TypeAlias = "tuple[tuple[str, str], ...]"  # name and kind of each element

_FEEDBACK_PARTS: _Arrangement = (
    ("timestamp", _WORD),
    ("poses", _ROW),
    ("mini_io", _WORD),
    ("user_io", _DATA),
    ("hand_io", _WORD),
    ("current", _ROW),
)

# Pose types in a result with two poses (receive formats 4 and 5). The key is how many numbers the result has.
_POSE_PAIRS = {15: (PoseType.P, PoseType.J), 18: (PoseType.T, PoseType.J)}

# Combinations of I/O in a set point or result, the most likely first.
_IO_COMBINATIONS = ("", "hand_io", "mini_io", "mini_io hand_io", "user_io", "user_io hand_io")

_SIZES = {pose_type: len(axes) for pose_type, axes in AXES.items()}

# a tuple, because `in` first compares identities, which is faster than == of dataclasses
_POSE_ONLY = (POSE_ONLY_FORMAT,)

_MAX_PARTS = 8  # maximum number of elements to examine; every slvMove format has fewer elements


class UserIO(NamedTuple):
    """I/O bits that slvMove reads (`data` is None) or writes: `size` bits, beginning with number `offset`."""

    offset: int
    size: int
    data: bytes | None = None


class SetPoint(NamedTuple):
    """The decoded parameter of slvMove.

    Attributes:
        mini_io: Word that the controller writes to the mini I/O; bit 0 is IO0.
        user_read: I/O bits that the controller returns in the reply.
        hand_io: Word that the controller writes to the hand I/O; bit 0 is IO48.
        guessed: Whether the pose type or the order of elements is a guess.
        problems: How the parameter differs from the expected form.
    """

    pose: Pose | None = None
    mini_io: int | None = None
    user_write: UserIO | None = None
    user_read: UserIO | None = None
    hand_io: int | None = None
    guessed: bool = False
    problems: tuple[Message, ...] = ()


class Feedback(NamedTuple):
    """The decoded result of slvMove.

    Attributes:
        timestamp: Time since the controller's start, in ms or µs, as a signed 32-bit number that overflows.
        poses: The current pose in each requested pose type, at most two.
        mini_io: Word read from the mini I/O; bit 0 is IO0.
        user_io: I/O bits that the set point requested.
        hand_io: Word read from the hand I/O; bit 0 is IO48.
    """

    timestamp: int | None = None
    microseconds: bool = False
    poses: tuple[Pose, ...] = ()
    mini_io: int | None = None
    user_io: bytes | None = None
    hand_io: int | None = None
    current: tuple[float, ...] = ()
    guessed: bool = False
    problems: tuple[Message, ...] = ()


def parse_set_point(
    parameter: Variant,
    pose_type: PoseType | None = None,
    send: SendFormat | None = None,
    receive: ReceiveFormat | None = None,
) -> SetPoint:
    """Decode slvMove's parameter. If its form is unexpected, return the elements that fit, and the problems.

    `pose_type`, `send` and `receive` are what slvChangeMode, slvSendFormat and slvRecvFormat set; each is
    None if its call was not captured.
    """
    bare = _bare_pose(parameter, pose_type)
    if bare and (send is None or send in _POSE_ONLY) and not (receive and receive.user_io):
        return SetPoint(bare)
    parts = _parts_of(parameter)
    choices = _set_point_arrangements(send, receive, _kinds_of_parts(parts))
    layout = next((each for each in choices if _is_plausible(each, parts)), choices[0])
    named, problems = _name_parts(layout, parts)
    pose, more = build_pose(named["pose"], pose_type) if "pose" in named else (None, ())
    return SetPoint(
        pose=pose,
        mini_io=named.get("mini_io"),
        user_write=_user_io(named, "write"),
        user_read=_user_io(named, "read"),
        hand_io=named.get("hand_io"),
        guessed=(pose is not None and pose.guessed) or (len(parts) > 1 and send is None),
        problems=(*problems, *more),
    )


def parse_feedback(
    result: Variant, pose_type: PoseType | None = None, receive: ReceiveFormat | None = None
) -> Feedback:
    """Decode slvMove's result. If the form of the result is unexpected, return the elements that fit, and the
    problems. EMPTY gives an empty `Feedback`. If the receive format is unknown, an array of numbers counts as
    a pose of the slave mode's `pose_type`.
    """
    microseconds = receive is not None and receive.microseconds
    if result.value is None:
        return Feedback(microseconds=microseconds)
    bare = _bare_pose(result, receive.bare_pose_type if receive else pose_type)
    if bare:
        return Feedback(None, microseconds, (bare,))
    parts = _parts_of(result)
    named, problems = _name_parts(_feedback_arrangements(receive, _kinds_of_parts(parts))[0], parts)
    poses, more = _poses_of_part(named["poses"], pose_type, receive) if "poses" in named else ((), ())
    return Feedback(
        timestamp=named.get("timestamp"),
        microseconds=microseconds,
        poses=poses,
        mini_io=named.get("mini_io"),
        user_io=named.get("user_io"),
        hand_io=named.get("hand_io"),
        current=named.get("current", ()),
        guessed=any(pose.guessed for pose in poses) or (len(parts) > 1 and receive is None),
        problems=(*problems, *more),
    )


def _bare_pose(variant: Variant, pose_type: PoseType | None) -> Pose | None:
    """Return the pose if the value has the usual form: a float array of exactly the right length."""
    if pose_type is None or variant.vt not in FLOAT_ARRAYS:
        return None
    row = variant.value
    if not isinstance(row, tuple) or len(row) != _SIZES[pose_type]:
        return None
    return Pose(pose_type, row)  # type: ignore[arg-type]  # these types hold floats


def _parts_of(variant: Variant) -> tuple[Variant, ...]:
    """Return the elements of a VARIANT array. A pose, even as a VARIANT array, counts as one element."""
    value = variant.value
    if not isinstance(value, tuple) or not value or not isinstance(value[0], Variant):
        return (variant,)
    if len(value) >= 6 and pose_numbers(variant) is not None:
        return (variant,)
    return tuple(item if isinstance(item, Variant) else Variant(VT.EMPTY, None) for item in value)


def _kind_of_part(part: Variant) -> str:
    if part.vt in FLOAT_ARRAYS:
        return _ROW
    value = part.value
    if isinstance(value, bytes):
        return _DATA
    if isinstance(value, int) and not isinstance(value, bool):
        return _WORD
    return _OTHER if pose_numbers(part) is None else _ROW


def _kinds_of_parts(parts: tuple[Variant, ...]) -> tuple[str, ...]:
    return tuple(_kind_of_part(part) for part in parts[:_MAX_PARTS])


def _matching_arrangements(
    layouts: Iterable[_Arrangement], kinds: tuple[str, ...]
) -> tuple[_Arrangement, ...]:
    """Return each arrangement in `layouts` whose elements have the kinds in `kinds`, in order. If there is no
    such arrangement, return all `layouts`.
    """
    listed = tuple(layouts)
    return tuple(layout for layout in listed if tuple(kind for _, kind in layout) == kinds) or listed


@lru_cache(maxsize=256)
def _set_point_arrangements(
    send: SendFormat | None, receive: ReceiveFormat | None, kinds: tuple[str, ...]
) -> tuple[_Arrangement, ...]:
    """Return the possible arrangements of a set point's elements, the most likely first."""
    sends = [send] if send else [SendFormat(**_flags(names)) for names in _IO_COMBINATIONS]
    user_reads = (False, True) if receive is None else (receive.user_io,)
    return _matching_arrangements(
        (tuple(_set_point_parts(form, read)) for form, read in product(sends, user_reads)), kinds
    )


def _set_point_parts(form: SendFormat, user_read: bool) -> Iterator[tuple[str, str]]:
    yield "pose", _ROW
    if form.mini_io:
        yield "mini_io", _WORD
    if form.user_io:
        yield from (("write_offset", _WORD), ("write_size", _WORD), ("write_data", _DATA))
    if user_read:
        yield from (("read_offset", _WORD), ("read_size", _WORD))
    if form.hand_io:
        yield "hand_io", _WORD


@lru_cache(maxsize=256)
def _feedback_arrangements(receive: ReceiveFormat | None, kinds: tuple[str, ...]) -> tuple[_Arrangement, ...]:
    """Return the possible arrangements of a result's elements, the most likely first."""
    if receive is not None:
        return _matching_arrangements([_feedback_parts(receive)], kinds)
    forms = product(("", "timestamp"), _IO_COMBINATIONS, ("", "current"))
    return _matching_arrangements(
        (
            _feedback_parts(ReceiveFormat((PoseType.J,), **_flags(f"{time} {names} {current}")))
            for time, names, current in forms
        ),
        kinds,
    )


def _flags(names: str) -> dict[str, Any]:
    return dict.fromkeys(names.split(), True)


def _feedback_parts(form: ReceiveFormat) -> _Arrangement:
    return tuple((name, kind) for name, kind in _FEEDBACK_PARTS if getattr(form, name))


def _name_parts(layout: _Arrangement, parts: tuple[Variant, ...]) -> tuple[dict[str, Any], list[Message]]:
    """Return a dictionary from the name of each element in `layout` to its value, and the problems."""
    named: dict[str, Any] = {}
    problems: list[Message] = []
    for name, kind in layout:
        place = len(named)
        if place < len(parts) and _kind_of_part(parts[place]) == kind:
            part = parts[place]
            named[name] = (pose_numbers(part) or ()) if kind == _ROW else part.value
        else:
            found = _kind_of_part(parts[place]) if place < len(parts) else _END
            problems.append(
                Message(
                    "slvmove.part-missing",
                    part=name,
                    expected=Message(f"slvmove.kind.{kind}"),
                    found=Message(f"slvmove.kind.{found}"),
                )
            )
    if len(parts) > len(named):
        problems.append(Message("slvmove.parts-unread", read=len(named), total=len(parts)))
    return named, problems


def _is_plausible(layout: _Arrangement, parts: tuple[Variant, ...]) -> bool:
    """Return whether `parts` fit `layout`, any user I/O is valid, and a hand I/O word without a mini I/O word
    has no bit above bit 23.
    """
    named, problems = _name_parts(layout, parts)
    if not all(_is_valid_user_io(run) for run in (_user_io(named, "write"), _user_io(named, "read")) if run):
        return False
    return not problems and ("mini_io" in named or not named.get("hand_io", 0) & 0xFF000000)


def _is_valid_user_io(run: UserIO) -> bool:
    """Return whether a range of I/O bits is plausible for user I/O: whole bytes, from bit 128 on. An offset
    or size of more than 16 bits is unlikely, and counts as not plausible.
    """
    return (
        128 <= run.offset <= 0xFFFF and run.offset % 8 == 0 and 0 < run.size <= 0xFFFF and run.size % 8 == 0
    )


def _user_io(named: Mapping[str, Any], verb: str) -> UserIO | None:
    offset, size = named.get(f"{verb}_offset"), named.get(f"{verb}_size")
    if offset is None or size is None:
        return None
    return UserIO(offset, size, named.get(f"{verb}_data"))


def _poses_of_part(
    row: tuple[float, ...], pose_type: PoseType | None, receive: ReceiveFormat | None
) -> tuple[tuple[Pose, ...], tuple[Message, ...]]:
    """Decode the number array of a result, which holds one or two poses."""
    types = receive.poses if receive else _POSE_PAIRS.get(len(row), ())
    if len(types) == 2:
        size = len(AXES[types[0]])
        first, problems = build_pose(row[:size], types[0])
        second, more = build_pose(row[size:], types[1])
        poses = tuple(each._replace(guessed=receive is None) for each in (first, second))
        return poses, problems + more
    # If the receive format is unknown, an array of the right length counts as one pose of `pose_type`, the
    # type of the slave mode. No public document describes the default format of slvMove's result.
    agrees = pose_type is not None and len(row) == len(AXES[pose_type])
    known = next(iter(types), pose_type if agrees else None)
    pose, problems = build_pose(row, known)
    return (pose,), problems
