"""Questions: read off the request, and found again for the reply."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Framing, Malformed, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.call_kind import (
    MAX_CONVERSATIONS,
    MAX_KINDS,
    CallKind,
    CallKinds,
    RecentRequests,
    call_kind_of,
)
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from bcapscope.traffic.recent_serials import MAX_SERIALS

SLV_MOVE = CallKind(64, "slvMove")


def conversation(port: int = 50001) -> Conversation:
    server = Endpoint("10.0.0.1", 5007)
    return Conversation(Endpoint("10.0.0.2", port), server, Transport.UDP, SERVER_PORT)


def execute(command: str, function_id: int = 64, handle: int = 1, serial: int = 1) -> Frame:
    variants = [Variant(VT.I4, handle), Variant(VT.BSTR, command), Variant(VT.R8, 1.5)]
    return Frame(encode_frame(serial, 0, function_id, variants))


@pytest.mark.parametrize(
    ("request_frame", "expected"),
    [
        (Frame(encode_frame(1, 0, 1, [Variant(VT.BSTR, ",WDT=400")])), CallKind(1, None)),
        (Frame(encode_frame(1, 0, 7, [Variant(VT.I4, 1), Variant(VT.BSTR, "Arm")])), CallKind(7, None)),
        (Frame(encode_frame(1, 0, 4000, [])), CallKind(4000, None)),
        (execute("slvMove"), SLV_MOVE),
        (execute("SLVMOVE"), CallKind(64, "SLVMOVE")),
        (execute("GetErrorLog", 17), CallKind(17, "GetErrorLog")),
        (execute("CurPos", 28), CallKind(28, "CurPos")),
        (execute("run", 41), CallKind(41, "run")),
        (execute("GetStatus", 87), CallKind(87, "GetStatus")),
        (execute(""), CallKind(64, "")),
        (execute("x" * 110), CallKind(64, "x" * 110)),
        (execute("x" * 200), CallKind(64, "x" * 200)),
        (execute("命令"), CallKind(64, "命令")),
        (Frame(encode_frame(1, 0, 64, [])), CallKind(64, None)),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.I4, 1)])), CallKind(64, None)),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.I4, 1)])[:29]), CallKind(64, None)),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.I4, 1), Variant(VT.I4, 2)])), CallKind(64, None)),
        (Frame(encode_frame(1, 0, 64, [Variant(VT.I2, 1), Variant(VT.BSTR, "slvMove")])), SLV_MOVE),
        (
            Frame(
                encode_frame(
                    9, 1, 64, [Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove")], Framing.VERSION_1_ZLIB
                )
            ),
            SLV_MOVE,
        ),
    ],
)
def test_a_request_tells_what_it_asks(request_frame: Frame, expected: CallKind) -> None:
    kinds = CallKinds()
    assert call_kind_of(request_frame) == expected
    assert kinds.kind_of(request_frame) == expected
    assert kinds.kind_of(request_frame) == expected  # what is remembered says the same


def test_equal_questions_are_one_object() -> None:
    kind_of = CallKinds().kind_of
    assert kind_of(execute("slvMove", handle=1)) is kind_of(execute("slvMove", handle=2, serial=7))
    without_parameter = Frame(encode_frame(1, 0, 64, [Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove")]))
    assert kind_of(without_parameter) is kind_of(without_parameter)


def in_blocks(command: str) -> Frame:
    """Return a compressed request whose first 58 bytes are the same for all commands of 7 characters."""
    plain = execute(command).raw
    body = plain[9:-1]
    packed = len(body).to_bytes(4, "little") + b"\x78\x01"
    for block in (body[:8], body[8:32], body[32:]):
        packed += struct.pack("<BHH", block == body[32:], len(block), len(block) ^ 0xFFFF) + block
    packed += zlib.adler32(body).to_bytes(4, "big") + b"\x01"
    return Frame(plain[:1] + (10 + len(packed)).to_bytes(4, "little") + b"\1\0\1\0" + packed + plain[-1:])


def test_compressed_requests_that_begin_with_equal_bytes_have_their_own_commands() -> None:
    kinds = CallKinds()
    commands = ("slvMove", "PosMove")
    assert in_blocks(commands[0]).raw[:58] == in_blocks(commands[1]).raw[:58]
    assert [kinds.kind_of(in_blocks(command)) for command in commands] == [
        CallKind(64, command) for command in commands
    ]


def test_a_command_that_is_cut_off_is_told_as_far_as_it_goes() -> None:
    kinds, whole = CallKinds(), execute("slvMove")
    assert kinds.kind_of(Frame(whole.raw[:-20])) == CallKind(64, "slvMov")
    assert kinds.kind_of(whole) == SLV_MOVE


@given(
    st.binary(max_size=80),
    st.lists(st.tuples(st.integers(9, 59), st.integers(0, 255)), max_size=3),
)
def test_what_is_remembered_never_changes_an_answer(tail: bytes, changes: list[tuple[int, int]]) -> None:
    kinds, whole = CallKinds(), execute("slvMove")
    raw = bytearray(whole.raw[:60] + tail)
    for position, value in changes:
        raw[position] = value
    frame = Frame(bytes(raw))
    assert [kinds.kind_of(each) for each in (whole, frame, frame)] == [SLV_MOVE, *[call_kind_of(frame)] * 2]


def test_a_frame_that_breaks_off_in_its_command_is_not_taken_for_a_whole_one() -> None:
    kinds, whole = CallKinds(), execute("CurPosѥ")
    broken = Frame(whole.raw[: 33 + whole.raw[29]])  # its last byte, which ends each frame, is the command's
    assert kinds.kind_of(broken) == CallKind(64, "CurPos")
    assert kinds.kind_of(whole) == CallKind(64, "CurPosѥ")
    assert kinds.kind_of(broken) == call_kind_of(broken) == CallKind(64, "CurPos")


def test_kinds_are_forgotten_in_time() -> None:
    kinds = CallKinds()
    first = kinds.kind_of(execute("slvMove", handle=0))
    for handle in range(1, MAX_KINDS):
        kinds.kind_of(execute("slvMove", handle=handle))
    assert kinds.kind_of(execute("slvMove", handle=0)) is first
    assert kinds.kind_of(execute("slvMove", handle=MAX_KINDS)) is not first
    assert kinds.kind_of(execute("slvMove", handle=0)) is not first


def ask(questions: RecentRequests, client: Conversation, frame: Frame) -> CallKind | None:
    return questions.kind_of(Observation(1, 0, 0, Flow(client, Direction.REQUEST), frame, 1))


def answer(questions: RecentRequests, client: Conversation, frame: Frame) -> CallKind | None:
    return questions.kind_of(Observation(2, 0, 0, Flow(client, Direction.RESPONSE), frame, 2))


def test_bytes_that_are_no_frame_are_about_nothing() -> None:
    flow = Flow(conversation(), Direction.REQUEST)
    assert RecentRequests().kind_of(Observation(1, 0, 0, flow, Malformed(b"?", ()), 1)) is None


def test_a_reply_finds_its_question_by_conversation_and_serial() -> None:
    questions = RecentRequests()
    one, two = conversation(1), conversation(2)
    ask(questions, one, execute("slvMove", serial=5))
    ask(questions, two, execute("CurPos", serial=5))
    reply = Frame(encode_frame(5, 0, 0, []))
    assert answer(questions, one, reply) == SLV_MOVE
    assert answer(questions, two, reply) == CallKind(64, "CurPos")
    assert answer(questions, one, Frame(encode_frame(6, 0, 0, []))) is None
    assert answer(questions, conversation(1), reply) is None


def test_the_later_of_two_requests_with_one_serial_is_meant() -> None:
    questions, client = RecentRequests(), conversation()
    ask(questions, client, execute("CurPos", serial=5))
    ask(questions, client, execute("slvMove", serial=5))
    assert answer(questions, client, Frame(encode_frame(5, 0, 0, []))) == SLV_MOVE


def test_the_latest_requests_are_known_and_long_ago_ones_are_not() -> None:
    questions, client = RecentRequests(), conversation()
    for serial in range(1, 3 * MAX_SERIALS):
        ask(questions, client, execute("slvMove", serial=serial))
    newest = 3 * MAX_SERIALS - 1
    found = [s for s in range(1, newest + 1) if answer(questions, client, Frame(encode_frame(s, 0, 0, [])))]
    assert found == list(range(newest - len(found) + 1, newest + 1))
    assert MAX_SERIALS <= len(found) <= 2 * MAX_SERIALS


def test_the_most_silent_conversation_is_forgotten_first() -> None:
    questions = RecentRequests()
    clients = [conversation(port) for port in range(MAX_CONVERSATIONS + 1)]
    for client in clients[:-1]:
        ask(questions, client, execute("slvMove"))
    reply = Frame(encode_frame(1, 0, 0, []))
    assert answer(questions, clients[0], reply) == SLV_MOVE
    ask(questions, clients[-1], execute("slvMove"))
    assert answer(questions, clients[0], reply) == SLV_MOVE
    assert answer(questions, clients[1], reply) is None


def test_a_conversation_that_is_over_is_forgotten() -> None:
    questions, client, reply = RecentRequests(), conversation(), Frame(encode_frame(5, 0, 0, []))
    ask(questions, client, execute("slvMove", serial=5))
    questions.close_conversation(client)
    assert answer(questions, client, reply) is None
