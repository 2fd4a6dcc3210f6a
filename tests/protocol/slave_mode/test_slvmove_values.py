"""slvMove taken apart: the slides' own frames, every format of the ROS driver, and any shape at all."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Value, Variant
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, Pose
from bcapscope.protocol.slave_mode.slvmove_values import (
    Feedback,
    SetPoint,
    UserIO,
    parse_feedback,
    parse_set_point,
)

P, J, T = PoseType.P, PoseType.J, PoseType.T
JOINTS = (1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 0.0, 0.0)
POSE = Variant.array(VT.R8, JOINTS)
CURRENTS = Variant.array(VT.R8, (0.25,) * 8)
READ, WRITE = UserIO(128, 16), UserIO(136, 8, b"\x55")


def word(value: int) -> Variant:
    return Variant(VT.I4, value)


def array(*parts: Variant) -> Variant:
    return Variant.array(VT.VARIANT, parts)


def row(*values: float) -> Variant:
    return Variant.array(VT.R8, values)


def set_point(send: int, user_read: bool) -> tuple[Variant, SetPoint]:
    """Build a parameter by the order of the ROS driver and what must come out of it."""
    parts, mini, hand = [POSE], None, None
    if send & 0x100:
        mini = 0x0A000000
        parts.append(word(mini))
    if send & 0x200:
        parts += [word(WRITE.offset), word(WRITE.size), Variant.array(VT.UI1, b"\x55")]
    if user_read:
        parts += [word(READ.offset), word(READ.size)]
    if send & 0x020:
        hand = 0x00050000
        parts.append(word(hand))
    expected = SetPoint(
        Pose(J, JOINTS), mini, WRITE if send & 0x200 else None, READ if user_read else None, hand
    )
    return (array(*parts) if len(parts) > 1 else POSE), expected


SENDS = [
    (send, read) for send in (0, 0x020, 0x100, 0x120, 0x200, 0x220, 0x400, 0x620) for read in (False, True)
]


@pytest.mark.parametrize(("send", "user_read"), SENDS)
def test_set_points_of_every_send_format(send: int, user_read: bool) -> None:
    parameter, expected = set_point(send, user_read)
    receive = ReceiveFormat.parse(0x202 if user_read else 0x002)
    assert parse_set_point(parameter, J, SendFormat.parse(send), receive) == expected


@pytest.mark.parametrize(("send", "user_read"), SENDS)
def test_set_points_whose_formats_were_not_seen_are_guessed(send: int, user_read: bool) -> None:
    parameter, expected = set_point(send, user_read)
    point = parse_set_point(parameter, J)
    assert point.guessed is (parameter is not POSE)
    assert (point.mini_io, point.user_write, point.user_read, point.hand_io, point.problems) == (
        expected.mini_io,
        expected.user_write,
        expected.user_read,
        expected.hand_io,
        (),
    )


def test_the_bare_pose_of_the_slides() -> None:
    # slvMove of DENSO Wave 2009, How to use the Slave mode: P type, Fig 1.
    sent = Variant.array(VT.R4, (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 1.0))
    point = parse_set_point(sent, P)
    assert point == SetPoint(Pose(P, sent.value))  # type: ignore[arg-type]
    assert point.pose is not None
    assert [axis.name for axis in point.pose.axes] == ["X", "Y", "Z", "Rx", "Ry", "Rz", "Fig"]
    assert parse_set_point(sent).guessed


def test_a_mixed_list_of_numbers_is_a_pose() -> None:
    sent = array(word(0), *(Variant(VT.R8, 0.5) for _ in range(7)))
    assert parse_set_point(sent, J) == SetPoint(Pose(J, (0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)))


def test_a_list_of_six_numbers_is_a_pose_of_an_rc7() -> None:
    sent = array(word(0), *(Variant(VT.R8, 0.5) for _ in range(5)))
    assert parse_set_point(sent, J) == SetPoint(Pose(J, (0, 0.5, 0.5, 0.5, 0.5, 0.5)))


def test_a_list_of_fewer_numbers_than_any_pose_has_is_no_pose() -> None:
    point = parse_set_point(array(*(Variant(VT.R8, 0.5) for _ in range(5))), J, SendFormat())
    assert point.pose is None
    assert str(point.problems[-1]) == "only 0 of 5 parts could be read"


def test_a_damaged_row_of_as_many_bytes_as_a_pose_has_axes_is_no_pose() -> None:
    point = parse_set_point(Variant(ARRAY | VT.R8, b"12345678", 3), J)
    assert point.pose == Pose(J, ())
    assert tuple(map(str, point.problems)) == ("0 numbers for a pose of type J, which has 8",)


def test_a_lone_word_is_hand_io_unless_it_has_bits_of_mini_io() -> None:
    for value in (0, 1, 0x00FFFFFF):
        assert parse_set_point(array(POSE, word(value)), J).hand_io == value
    for value in (0x01000000, -(1 << 31)):
        assert parse_set_point(array(POSE, word(value)), J).mini_io == value


@pytest.mark.parametrize(
    ("offset", "size", "is_plausible"),
    [
        (128, 8, True),
        (120, 8, False),
        (132, 8, False),
        (0xFFF8, 0xFFF8, True),
        (0x10000, 8, False),
        (128, 0x10000, False),
        (128, 0, False),
        (128, 12, False),
    ],
)
def test_two_words_are_user_io_only_if_they_can_be_its_bits(
    offset: int, size: int, is_plausible: bool
) -> None:
    point = parse_set_point(array(POSE, word(offset), word(size)), J)
    assert (point.user_read is not None) is is_plausible
    assert (point.mini_io == offset) is not is_plausible


def test_bits_to_read_without_their_number_are_not_read() -> None:
    point = parse_set_point(array(POSE, word(128)), J, SendFormat(), ReceiveFormat.parse(0x202))
    assert point.user_read is None
    assert tuple(map(str, point.problems)) == ("read_size is missing: an integer expected, the end found",)


@pytest.mark.parametrize("user_read", [False, True])
def test_what_a_result_carries_shows_in_a_set_point_of_a_known_format(user_read: bool) -> None:
    parameter, expected = set_point(0x120, user_read)
    assert parse_set_point(parameter, J, SendFormat.parse(0x120)) == expected


def test_what_the_format_asks_for_and_is_not_there() -> None:
    point = parse_set_point(POSE, J, SendFormat(mini_io=True), ReceiveFormat(poses=(J,)))
    assert point.pose == Pose(J, JOINTS)
    assert tuple(map(str, point.problems)) == ("mini_io is missing: an integer expected, the end found",)


def test_a_bare_pose_lacks_the_user_io_that_the_result_is_to_carry() -> None:
    point = parse_set_point(POSE, J, SendFormat(), ReceiveFormat.parse(0x202))
    assert point.pose == Pose(J, JOINTS)
    assert tuple(map(str, point.problems)) == (
        "read_offset is missing: an integer expected, the end found",
        "read_size is missing: an integer expected, the end found",
    )


def test_each_kind_of_part_has_a_name() -> None:
    point = parse_set_point(array(word(7), POSE), J, SendFormat(user_io=True), ReceiveFormat())
    assert str(point.problems[0]) == "pose is missing: numbers expected, an integer found"
    assert str(point.problems[-2]) == "write_data is missing: bytes expected, numbers found"


def test_parts_out_of_place_do_not_hide_the_others() -> None:
    parameter = array(POSE, Variant(VT.BSTR, "?"), word(7))
    point = parse_set_point(parameter, J, SendFormat(hand_io=True), ReceiveFormat())
    assert (point.pose, point.hand_io) == (Pose(J, JOINTS), None)
    assert tuple(map(str, point.problems)) == (
        "hand_io is missing: an integer expected, something else found",
        "only 1 of 3 parts could be read",
    )


RECEIVES = [
    (pose, time | io | current)
    for pose in range(1, 6)
    for time in (0, 0x010)
    for io in (0, 0x020, 0x100, 0x120, 0x200, 0x220)
    for current in (0, 0x040)
]


@pytest.mark.parametrize(("pose", "bits"), RECEIVES)
def test_results_of_every_receive_format(pose: int, bits: int) -> None:
    form = ReceiveFormat.parse(pose | bits)
    sizes = [len(AXES[type_]) for type_ in form.poses]
    values = tuple(float(number) for number in range(sum(sizes)))
    parts = [word(123456)] if bits & 0x010 else []
    parts.append(row(*values))
    parts += [word(0x11)] if bits & 0x100 else []
    parts += [Variant.array(VT.UI1, b"\x01\x02")] if bits & 0x200 else []
    parts += [word(0x22)] if bits & 0x020 else []
    parts += [CURRENTS] if bits & 0x040 else []
    answer = parse_feedback(array(*parts) if len(parts) > 1 else parts[0], J, form)
    assert answer == Feedback(
        timestamp=123456 if bits & 0x010 else None,
        poses=tuple(
            Pose(type_, values[sum(sizes[:index]) : sum(sizes[: index + 1])])
            for index, type_ in enumerate(form.poses)
        ),
        mini_io=0x11 if bits & 0x100 else None,
        user_io=b"\x01\x02" if bits & 0x200 else None,
        hand_io=0x22 if bits & 0x020 else None,
        current=(0.25,) * 8 if bits & 0x040 else (),
    )


@pytest.mark.parametrize(
    ("result", "pose_type", "poses", "guessed"),
    [
        (Variant.array(VT.R4, JOINTS), J, (Pose(J, JOINTS),), False),
        (POSE, None, (Pose(J, JOINTS, (), True),), True),
        (POSE, P, (Pose(J, JOINTS, (), True),), True),
        (
            row(*range(15)),
            J,
            (Pose(P, tuple(range(7)), (), True), Pose(J, tuple(range(7, 15)), (), True)),
            True,
        ),
        (
            row(*range(18)),
            J,
            (Pose(T, tuple(range(10)), (), True), Pose(J, tuple(range(10, 18)), (), True)),
            True,
        ),
        (array(word(99), POSE), J, (Pose(J, JOINTS),), True),
        (EMPTY, J, (), False),
    ],
)
def test_results_whose_format_was_not_seen(
    result: Variant, pose_type: PoseType | None, poses: tuple[Pose, ...], guessed: bool
) -> None:
    answer = parse_feedback(result, pose_type)
    assert (answer.poses, answer.guessed, answer.problems) == (poses, guessed, ())


@pytest.mark.parametrize("current", [0, 0x040])
@pytest.mark.parametrize("io", [0, 0x020, 0x100, 0x120, 0x200, 0x220])
@pytest.mark.parametrize("time", [0, 0x010])
def test_each_arrangement_of_a_result_is_guessed_from_its_parts(time: int, io: int, current: int) -> None:
    words = [word(0x11)] * bool(io & 0x100) + [word(0x22)] * bool(io & 0x020)
    data = [Variant.array(VT.UI1, b"\x01\x02")] * bool(io & 0x200)
    parts = [word(9)] * bool(time) + [POSE] + data + words + [CURRENTS] * bool(current)
    first, *second = (each.value for each in words) if words else (None,)
    hand = second[0] if second else first  # a lone word is taken for hand I/O
    assert parse_feedback(array(*parts), J) == Feedback(
        timestamp=9 if time else None,
        poses=(Pose(J, JOINTS),),
        mini_io=first if second else None,  # type: ignore[arg-type]
        user_io=b"\x01\x02" if data else None,
        hand_io=hand,  # type: ignore[arg-type]
        current=(0.25,) * 8 if current else (),
        guessed=len(parts) > 1,
    )


def test_a_format_without_a_pose_returns_none() -> None:
    answer = parse_feedback(array(word(9), word(0x22)), J, ReceiveFormat.parse(0x030))
    assert answer == Feedback(timestamp=9, hand_io=0x22)


def test_time_stamps_keep_their_unit() -> None:
    form = ReceiveFormat.parse(0x012, microseconds=True)
    answer = parse_feedback(array(word(-5), POSE), J, form)
    assert (answer.timestamp, answer.microseconds) == (-5, True)


def test_a_result_that_is_too_short_says_so() -> None:
    answer = parse_feedback(row(1.0, 2.0), J, ReceiveFormat.parse(0x004))
    assert tuple(map(str, answer.problems)) == (
        "2 numbers for a pose of type P, which has 7",
        "0 numbers for a pose of type J, which has 8",
    )


SCALARS: st.SearchStrategy[Variant] = st.one_of(
    st.just(EMPTY),
    st.builds(Variant, st.just(VT.I4), st.integers(-(2**31), 2**31 - 1)),
    st.builds(Variant, st.just(VT.R8), st.floats()),
    st.builds(Variant, st.just(VT.BSTR), st.text(max_size=4)),
    st.builds(Variant, st.just(VT.BOOL), st.booleans()),
    st.builds(lambda data: Variant.array(VT.UI1, data), st.binary(max_size=4)),
    st.builds(lambda data: Variant.array(VT.R8, tuple(data)), st.lists(st.floats(), max_size=20)),
    st.builds(lambda data: Variant.array(VT.BSTR, tuple(data)), st.lists(st.text(max_size=2), max_size=3)),
    st.builds(lambda data, vt: Variant(vt, data, 3), st.binary(max_size=4), st.integers(0, 0xFFFF)),
)
SHAPES = st.recursive(
    SCALARS, lambda inner: st.builds(lambda items: array(*items), st.lists(inner, max_size=10)), max_leaves=12
)
SEND_FORMATS = st.none() | st.builds(SendFormat.parse, st.integers(0, 0xFFF))
RECEIVE_FORMATS = st.none() | st.builds(ReceiveFormat.parse, st.integers(0, 0xFFF), st.booleans())
POSE_TYPES = st.none() | st.sampled_from(PoseType)


def numbers_in(value: Value | Variant) -> int:
    inner = value.value if isinstance(value, Variant) else value
    return sum(map(numbers_in, inner)) if isinstance(inner, tuple) else isinstance(inner, int | float)


@given(SHAPES, POSE_TYPES, SEND_FORMATS, RECEIVE_FORMATS)
def test_any_shape_gives_a_set_point(
    shape: Variant, pose_type: PoseType | None, send: SendFormat | None, receive: ReceiveFormat | None
) -> None:
    point = parse_set_point(shape, pose_type, send, receive)
    if point.pose is None:
        assert point.problems
    else:
        assert len(point.pose.values) + len(point.pose.extra) <= numbers_in(shape)
        assert pose_type in (None, point.pose.type)
    assert all(str(problem).isprintable() for problem in point.problems)


@given(SHAPES, POSE_TYPES, RECEIVE_FORMATS)
def test_any_shape_gives_an_answer(
    shape: Variant, pose_type: PoseType | None, receive: ReceiveFormat | None
) -> None:
    answer = parse_feedback(shape, pose_type, receive)
    taken = sum(len(pose.values) + len(pose.extra) for pose in answer.poses) + len(answer.current)
    assert taken <= numbers_in(shape)
    assert all(str(problem).isprintable() for problem in answer.problems)
