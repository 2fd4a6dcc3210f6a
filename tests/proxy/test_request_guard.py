"""The guard: what it refuses, and what nobody holds up."""

from __future__ import annotations

import random
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.guard import always_passes, passes_read_only
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS, commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.proxy.request_guard import GuardTarget, RequestGuard, read_target
from tests.english import english
from tests.strategies import mutated_frames

EXECUTE = 64


def asked(function_id: int, command: str | None = None, *more: Variant) -> Frame:
    """Make a request."""
    arguments = [Variant(VT.I4, 1)]
    if command is not None:
        arguments.append(Variant(VT.BSTR, command))
    return Frame(encode_frame(5, 0, function_id, [*arguments, *more]))


NAMES = {function.name: function.id for function in FUNCTIONS.values()}
ZERO = Variant(VT.I4, 0)
MODE = Variant(VT.I4, 0x101)


@pytest.mark.parametrize(
    "frame",
    [
        asked(NAMES["Robot_Halt"]),
        asked(EXECUTE, "slvChangeMode", ZERO),
        asked(EXECUTE, "SLVCHANGEMODE", Variant(VT.I2, 0)),
        asked(NAMES["Robot_Release"]),
        asked(NAMES["Controller_Disconnect"]),
        asked(NAMES["Service_Stop"]),
        asked(NAMES["Service_Start"]),
        asked(NAMES["Variable_GetValue"]),
        asked(EXECUTE, "CurJnt"),
    ],
    ids=lambda frame: f"{frame.code} {frame.argc}",
)
def test_reading_and_stopping_pass(frame: Frame) -> None:
    assert RequestGuard(read_only=True).refusal_reason(frame) is None


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (asked(EXECUTE, "slvMove", Variant.array(VT.R4, (1.0,))), "read-only: Robot_Execute 'slvMove'"),
        (asked(EXECUTE, "slvChangeMode", MODE), "read-only: Robot_Execute 'slvChangeMode'"),
        (asked(NAMES["Robot_Move"]), "read-only: Robot_Move"),
        (asked(NAMES["Variable_PutValue"]), "read-only: Variable_PutValue"),
        (asked(EXECUTE, "NobodyKnowsThis"), "read-only: Robot_Execute 'NobodyKnowsThis'"),
        (asked(200), "read-only: Unknown(200)"),
        (asked(EXECUTE), "read-only: Robot_Execute"),
        (Frame(asked(NAMES["Variable_GetValue"]).raw[:-1]), "read-only: a damaged Variable_GetValue"),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_what_moves_or_changes_or_is_not_known_is_refused(frame: Frame, reason: str) -> None:
    assert english(RequestGuard(read_only=True).refusal_reason(frame)) == reason


def test_every_command_of_the_catalogue_goes_by_its_effect() -> None:
    guard = RequestGuard(read_only=True)
    for function_id in COMMAND_FUNCTIONS:
        for command in commands_of(function_id):
            frame = asked(function_id, command.name, MODE)
            passes = command.effect <= CallEffect.SESSION or always_passes(function_id, frame.variants)
            assert (guard.refusal_reason(frame) is None) is passes, command.name


def test_lists_block_and_allow() -> None:
    guard = RequestGuard(block=[read_target("slvmove"), read_target("Robot_Move")])
    assert english(guard.refusal_reason(asked(EXECUTE, "slvMove"))) == "Robot_Execute 'slvMove' is blocked"
    assert english(guard.refusal_reason(asked(NAMES["Robot_Move"]))) == "Robot_Move is blocked"
    assert guard.refusal_reason(asked(NAMES["Variable_PutValue"])) is None
    guard = RequestGuard(
        True, block=[read_target("slvMove")], allow=[read_target("Robot_Execute"), read_target("Robot_Move")]
    )
    assert guard.refusal_reason(asked(EXECUTE, "slvMove"))
    assert guard.refusal_reason(asked(EXECUTE, "TakeArm")) is None
    assert guard.refusal_reason(asked(NAMES["Robot_Move"])) is None
    assert guard.refusal_reason(asked(NAMES["Robot_Drive"]))


def test_only_the_allowed_command_is_allowed() -> None:
    guard = RequestGuard(True, allow=[read_target("slvMove"), read_target("Robot_Execute:MyOwn")])
    for command, is_allowed in (("SlvMove", True), ("myown", True), ("TakeArm", False)):
        assert (guard.refusal_reason(asked(EXECUTE, command)) is None) is is_allowed
    assert guard.refusal_reason(asked(NAMES["Robot_Move"]))


def test_nobody_blocks_what_stops_the_robot() -> None:
    guard = RequestGuard(block=[read_target("Robot_Halt"), read_target("slvChangeMode")])
    assert guard.refusal_reason(asked(NAMES["Robot_Halt"])) is None
    assert guard.refusal_reason(asked(EXECUTE, "slvChangeMode", ZERO)) is None
    assert guard.refusal_reason(asked(EXECUTE, "slvChangeMode", MODE))


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("Robot_Move", GuardTarget(72, None)),
        ("robot_move", GuardTarget(72, None)),
        ("SlvMove", GuardTarget(None, "slvmove")),
        ("Robot_Execute:MyOwn", GuardTarget(64, "myown")),
    ],
)
def test_targets_are_read(text: str, target: GuardTarget) -> None:
    assert read_target(text) == target


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("slvMve", "did you mean 'slvMove'.*Robot_Execute:slvMve"),
        ("Robot_Mov", "did you mean 'Robot_Move'"),
        ("Robot_Move:x", "'Robot_Move' takes no commands"),
        ("x:y", "'x' takes no commands"),
    ],
)
def test_misspelt_targets_are_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_target(text)


# what is damaged, or may be read in more ways than one

READ = asked(NAMES["Variable_GetValue"]).raw
MOVE = asked(EXECUTE, "slvMove", Variant.array(VT.R4, (1.0,))).raw
HALT = asked(NAMES["Robot_Halt"], "").raw
READ_ONLY, NO_POINTS = RequestGuard(read_only=True), RequestGuard(block=[read_target("slvMove")])


def resized(raw: bytes) -> bytes:
    """Give a frame the length that it has."""
    return raw[:1] + struct.pack("<I", len(raw)) + raw[5:]


def reading_by_values(command: str, hidden: str) -> bytes:
    """Make a frame that has one command by the values of its arguments, another by their lengths."""
    handle, shown, empty = (
        encode_frame(5, 0, EXECUTE, (Variant(VT.I4, 1),))[15:-1],
        *(encode_frame(5, 0, EXECUTE, (each,))[15:-1] for each in (Variant(VT.BSTR, command), MODE)),
    )
    inner = encode_frame(5, 0, EXECUTE, (Variant(VT.BSTR, hidden),))[15:-1]
    # The length of the handle covers the shown command: who goes by lengths finds the hidden one behind it.
    covering = struct.pack("<I", len(handle) - 4 + len(shown)) + handle[4:]
    return resized(
        encode_frame(5, 0, EXECUTE)[:13] + b"\x03\x00" + covering + shown + inner + empty + b"\x04"
    )


@pytest.mark.parametrize(
    "raw",
    [
        reading_by_values("CurJnt", "slvMove"),
        reading_by_values("slvMove", "CurJnt"),
        READ[:13] + b"\x05\x00" + READ[15:],
        READ[:-1] + b"\x05",
        READ[:-1],
        READ[:1] + struct.pack("<I", len(READ) + 1) + READ[5:],
        resized(READ[:-1] + MOVE + b"\x04"),
        HALT[:1] + struct.pack("<I", 16) + HALT[5:-1] + b"\x00" + MOVE,
        HALT[:-1] + b"\x00" + MOVE,
        resized(HALT[:-1] + MOVE + b"\x04"),
        resized(HALT[:-1] + MOVE[:-9] + b"\x04"),
        HALT[:-3],
        b"\x00" + MOVE,
        MOVE[:20],
        b"",
    ],
)
@pytest.mark.parametrize("guard", [READ_ONLY, NO_POINTS], ids=["read-only", "block"])
def test_what_is_damaged_hides_nothing(guard: RequestGuard, raw: bytes) -> None:
    passing, refused, dropped = guard.filter_frames(raw)
    for item in parse_datagram(passing) if passing else ():
        assert isinstance(item, Frame)
        assert item.code in (NAMES["Variable_GetValue"], NAMES["Robot_Halt"])
    assert MOVE[9:] not in passing
    assert refused or dropped or not raw or guard is NO_POINTS


@pytest.mark.parametrize(("end", "passes"), [(b"\x00", True), (b"\x04", False)])
def test_a_frame_that_begins_in_the_length_field_is_found(end: bytes, passes: bool) -> None:
    # The length 4097 has the bytes 01 10 00 00: SOH, and the beginning of the length 16.
    raw = struct.pack("<BIHHIH", 1, 4097, 0x200, 0, NAMES["Robot_Halt"], 0)
    raw += b"\x00" + end + bytes(4097 - 18) + b"\x04"
    assert READ_ONLY.filter_frames(raw)[0] == (raw if passes else b"")


def test_a_frame_behind_a_byte_that_could_begin_another_is_found() -> None:
    # The first 01 begins no frame, because the frame that it would begin does not end with EOT.
    hidden = b"\x01\x01\x10\x00\x00\x00" + bytes(10) + b"\x04"
    for inside in (hidden, hidden[:-1] + b"\x00"):
        raw = resized(HALT[:-1] + inside + bytes(5000) + b"\x04")
        assert (READ_ONLY.filter_frames(raw).passing == b"") is (inside is hidden)


def test_bytes_that_are_no_frame_are_dropped_and_counted() -> None:
    assert READ_ONLY.filter_frames(b"\x00\x02" + READ) == (b"", (), 2 + len(READ))
    assert READ_ONLY.filter_frames(READ + b"\x00\x02\x03") == (READ, (), 3)


def test_a_block_list_lets_small_errors_pass_in_what_it_does_not_name() -> None:
    raw = encode_frame(5, 0, NAMES["Variable_PutValue"], (Variant(VT.I4, 2), Variant(VT.I4, 7)))
    wrong_length = Frame(raw[:15] + b"\x0b" + raw[16:])
    assert wrong_length.problems
    assert NO_POINTS.refusal_reason(wrong_length) is None
    assert english(NO_POINTS.refusal_reason(Frame(READ[:-1]))) == (
        "a damaged Variable_GetValue, which a controller may read as a blocked call"
    )


def test_only_a_halt_may_have_errors_and_pass() -> None:
    off = asked(EXECUTE, "slvChangeMode", ZERO).raw
    left_over = resized(off[:-1] + bytes(3) + b"\x04")
    for guard in (READ_ONLY, NO_POINTS):
        assert guard.refusal_reason(Frame(off)) is None
        assert guard.refusal_reason(Frame(left_over)) is not None


def packed(function_id: int, *values: Variant) -> bytes:
    return encode_frame(5, 1, function_id, values, Framing.VERSION_1_ZLIB)


def test_a_compressed_halt_with_errors_is_refused() -> None:
    raw = bytearray(packed(NAMES["Robot_Halt"], Variant(VT.I4, 1), Variant(VT.BSTR, "")))
    raw[9] += 1  # the unpacked size
    frame = Frame(bytes(raw))
    assert frame.framing is Framing.VERSION_1_ZLIB
    assert READ_ONLY.refusal_reason(frame)


def test_compressed_bytes_that_cannot_be_unpacked_are_refused() -> None:
    raw = bytearray(packed(EXECUTE, Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove")))
    raw[20] ^= 0xFF
    frame = Frame(bytes(raw))
    assert frame.framing is Framing.PLAIN
    assert NO_POINTS.refusal_reason(frame)


def test_a_compressed_frame_with_much_data_passes() -> None:
    noise = random.Random(1).randbytes(5000)
    raw = packed(NAMES["Variable_PutValue"], Variant(VT.I4, 1), Variant.array(VT.UI1, noise))
    assert len(raw) > 5000
    assert NO_POINTS.filter_frames(raw) == (raw, (), 0)


def test_a_command_by_lengths_is_no_way_around_a_halt_or_a_change_of_mode() -> None:
    zero = reading_by_values("slvChangeMode", "slvMove").replace(
        encode_frame(5, 0, 1, (MODE,))[15:-1], encode_frame(5, 0, 1, (ZERO,))[15:-1]
    )
    assert Frame(zero).problems
    assert READ_ONLY.refusal_reason(Frame(zero))
    assert NO_POINTS.refusal_reason(Frame(zero))


def test_a_halt_passes_though_its_client_errs_in_the_arguments() -> None:
    wrong_length = HALT[:15] + b"\x0b" + HALT[16:]
    left_over = resized(HALT[:-1] + b"\x00\x00\x00" + b"\x04")
    for raw in (wrong_length, left_over, encode_frame(5, 0, NAMES["Robot_Halt"])):
        assert READ_ONLY.filter_frames(raw) == (raw, (), 0)
        assert RequestGuard(block=[read_target("Robot_Halt")]).filter_frames(raw) == (raw, (), 0)


@pytest.mark.parametrize("command", ["slvMove", "SLVMOVE", "slvMove\0", "slvMove\0x", " slvMove "])
def test_a_blocked_command_is_known_in_any_dress(command: str) -> None:
    assert NO_POINTS.refusal_reason(asked(EXECUTE, command))
    assert READ_ONLY.refusal_reason(asked(EXECUTE, command))


def test_a_command_that_is_no_string_may_be_the_blocked_one() -> None:
    odd = Frame(encode_frame(5, 0, EXECUTE, (Variant(VT.I4, 1), Variant.array(VT.BSTR, ("slvMove",)))))
    assert NO_POINTS.refusal_reason(odd)
    assert not RequestGuard(block=[read_target("Robot_Move")]).refusal_reason(odd)


def test_compressed_frames_are_judged_by_what_is_in_them() -> None:
    for raw, refused in ((READ, False), (MOVE, True), (HALT, False)):
        plain = Frame(raw)
        values = [argument.variant for argument in plain.arguments]
        packed = Frame(encode_frame(5, 1, plain.code, values, Framing.VERSION_1_ZLIB))
        assert packed.framing is Framing.VERSION_1_ZLIB
        assert bool(READ_ONLY.refusal_reason(packed)) is refused


def both_ways() -> bytes:
    """Make a frame that reads when it is unpacked, and moves when it is taken as it stands."""
    inner = READ[9:-1]
    stored = zlib.compress(inner, 0)
    body = inner[:0]
    # empty stored blocks before the real one: room for 376 arguments of ten bytes
    blocks = b"\x00\x00\x00\xff\xff" * 800
    body = stored[:2] + blocks + stored[2:]
    raw = b"\x01" + bytes(4) + struct.pack("<HHI", 5, 1, len(inner)) + body + b"\x01\x04"
    return resized(raw)


def test_a_compressed_frame_that_may_be_taken_for_a_plain_one_is_refused() -> None:
    frame = Frame(both_ways())
    assert frame.framing is Framing.VERSION_1_ZLIB
    assert frame.code == NAMES["Variable_GetValue"]
    assert frame.problems == ()
    assert english(READ_ONLY.refusal_reason(frame)) == "read-only: a damaged Variable_GetValue"


@given(st.lists(mutated_frames() | st.sampled_from([READ, MOVE, HALT]) | st.binary(max_size=20), max_size=4))
def test_whatever_comes_only_whole_frames_that_read_or_stop_go_on(pieces: list[bytes]) -> None:
    passing, _, _ = READ_ONLY.filter_frames(b"".join(pieces))
    for item in parse_datagram(passing) if passing else ():
        assert isinstance(item, Frame)
        assert item.length == len(item.raw)
        values = [argument.variant for argument in item.arguments]
        assert passes_read_only(item.code, values)
        assert not item.problems or always_passes(item.code, ())
