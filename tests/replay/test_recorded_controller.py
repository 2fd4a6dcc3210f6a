"""The controller's side of a recorded session, played to clients."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.protocol.tables.hresult import E_BUSY, E_FAIL, E_NOTIMPL, E_TOO_MUCH_DATA, S_EXECUTING, S_OK
from bcapscope.replay.recorded_controller import IDLE_CLIENT_NS, RecordedController, ScriptLookup
from bcapscope.replay.replay_script import ReplayScript, ScriptCall
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.hosted_client import MAX_WAITING
from bcapscope.simulator.simulator import MAX_CLIENTS, SimulatorOutput
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport
from tests.replay.sessions import perform, recorded
from tests.replay.test_script_player import motion

MS = 1_000_000
CONVERSATION = Conversation(
    Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT
)
START, GET, MOVE = CallKind(1, None), CallKind(101, None), CallKind(64, "slvMove")


def line(question: CallKind, *arguments: Variant, answer: int | None = 0, **other: Any) -> ScriptCall:
    """Make a line whose answer tells it from others."""
    fields: dict[str, Any] = {"number": 1, "offset": 0, "duration": 0, "notice_offsets": ()}
    fields |= (
        {"hresult": None, "values": ()} if answer is None else {"hresult": S_OK, "values": (i4(answer),)}
    )
    return ScriptCall(kind=question, arguments=arguments, **{**fields, **other})


def played(
    *lines: ScriptCall, delays: bool = True, replies: ReplyReserved = ReplyReserved.ZERO
) -> RecordedController:
    return RecordedController(
        ReplayScript(CONVERSATION, lines, replies), lambda peer, report: None, delays=delays
    )


def codes(outputs: list[SimulatorOutput]) -> list[tuple[int, int]]:
    """Return serial and result of each frame."""
    return [(frame.serial, frame.code) for frame in (Frame(output.data) for output in outputs)]


def get(serial: int, handle: int = 1, reserved: int = 0) -> bytes:
    return encode_frame(serial, reserved, 101, [i4(handle)])


# which line answers


@pytest.mark.parametrize(
    ("asked", "answers"),
    [
        ([1, 1, 1], [10, 12, 13]),  # the next like it, in order
        ([1, 1, 1, 1, 1], [10, 12, 13, 13, 13]),  # then the last
        ([2, 2], [11, 11]),
        ([2, 1, 1], [11, 12, 13]),
        ([7], [10]),  # other arguments: the next at all
        ([7, 7, 7, 7, 7], [10, 11, 12, 13, 13]),
    ],
)
def test_lines_are_found_in_order(asked: list[int], answers: list[int]) -> None:
    lines = (
        line(GET, i4(1), answer=10),
        line(GET, i4(2), answer=11),
        line(GET, i4(1), answer=12),
        line(GET, i4(1), answer=13),
    )
    lookup = ScriptLookup(lines)
    found = [lookup.find(GET, (i4(handle),)) for handle in asked]
    assert [each and each.values[0].value for each in found] == answers


def test_a_new_start_begins_from_the_top() -> None:
    lookup = ScriptLookup((line(START), line(GET, i4(1), answer=1), line(GET, i4(1), answer=2)))
    told = []
    for question in (START, GET, GET, START, GET):
        found = lookup.find(question, () if question is START else (i4(1),))
        assert found is not None
        told.append(found.values[0].value)
    assert told == [0, 1, 2, 0, 1]


def test_commands_are_told_apart_without_regard_to_case() -> None:
    lookup = ScriptLookup((line(MOVE, i4(1), bstr("slvMove")),))
    assert lookup.find(CallKind(64, "SLVMOVE"), ()) is not None
    assert lookup.find(CallKind(64, "slvMov"), ()) is None
    assert lookup.find(GET, ()) is None


# time


def test_an_answer_takes_as_long_as_it_did() -> None:
    controller = played(line(GET, i4(1), duration=5 * MS, notice_offsets=(2 * MS, 4 * MS)))
    assert controller.on_datagram("a", get(7), 100) == []
    assert controller.due(100) == 100 + 2 * MS
    assert codes(controller.advance(100 + 2 * MS)) == [(7, S_EXECUTING)]
    assert codes(controller.advance(100 + 5 * MS)) == [(7, S_EXECUTING), (7, S_OK)]
    assert controller.due(100 + 5 * MS) is None


def test_or_none_if_so_wished() -> None:
    controller = played(line(GET, i4(1), duration=5 * MS, notice_offsets=(2 * MS,)), delays=False)
    assert codes(controller.on_datagram("a", get(7), 0)) == [(7, S_OK)]


def test_a_retry_is_no_new_call() -> None:
    controller = played(
        line(GET, i4(1), answer=1, duration=5 * MS), line(GET, i4(1), answer=2), replies=ReplyReserved.ECHOED
    )
    assert controller.on_datagram("a", get(7), 0) == []
    assert controller.on_datagram("a", get(8, reserved=7), MS) == []
    (answer,) = controller.advance(5 * MS)
    frame = Frame(answer.data)
    assert (frame.serial, frame.reserved, frame.arguments[0].variant.value) == (8, 7, 1)
    (again,) = controller.on_datagram("a", get(9, reserved=7), 6 * MS)
    assert Frame(again.data).arguments[0].variant.value == 1
    (other,) = controller.on_datagram("a", get(10), 7 * MS)
    assert Frame(other.data).arguments[0].variant.value == 2


def test_what_was_never_answered_is_not_answered_until_the_client_goes_on() -> None:
    controller = played(line(GET, i4(1), answer=None), line(GET, i4(2), answer=2))
    assert controller.on_datagram("a", get(7), 0) == []
    assert controller.on_datagram("a", get(8, reserved=7), MS) == []
    assert controller.due(0) is None
    assert codes(controller.on_datagram("a", get(9, handle=2), 2 * MS)) == [(9, S_OK)]


def test_calls_that_come_before_an_answer_wait_for_it() -> None:
    controller = played(line(GET, i4(1), answer=1, duration=5 * MS), line(GET, i4(2), answer=2))
    controller.on_connect("a", 0)
    requests = get(1) + b"".join(get(serial, 2) for serial in range(2, MAX_WAITING + 3))
    assert codes(controller.on_segment("a", requests, 0)) == [(MAX_WAITING + 2, E_BUSY)]
    assert codes(controller.advance(5 * MS)) == [(serial, S_OK) for serial in range(1, MAX_WAITING + 2)]


def test_calls_behind_one_that_was_never_answered_are_answered() -> None:
    controller = played(
        line(GET, i4(1), duration=5 * MS),
        line(GET, i4(2), answer=None),
        line(GET, i4(3), answer=3, duration=MS),
    )
    controller.on_connect("a", 0)
    assert controller.on_segment("a", get(1) + get(2, 2) + get(3, 3), 0) == []
    assert codes(controller.advance(5 * MS)) == [(1, S_OK)]
    assert codes(controller.advance(6 * MS)) == [(3, S_OK)]


def test_a_late_try_of_a_call_that_was_given_up_is_no_new_call() -> None:
    controller = played(
        line(GET, i4(1), answer=1), line(GET, i4(2), answer=None), line(GET, i4(1), answer=2), delays=False
    )
    for serial, handle, reserved, answer in [
        (7, 1, 0, [(7, S_OK)]),
        (8, 2, 0, []),
        (9, 1, 0, [(9, S_OK)]),
        (10, 2, 8, []),  # these were on the way for long
        (7, 1, 0, [(7, S_OK)]),
    ]:
        found = controller.on_datagram("a", get(serial, handle, reserved), 0)
        assert codes(found) == answer
    assert Frame(found[0].data).arguments[0].variant.value == 1


def test_a_call_that_broke_off_while_it_was_executed_ends_likewise() -> None:
    controller = played(line(GET, i4(1), answer=None, notice_offsets=(2 * MS,)))
    controller.on_datagram("a", get(7), 0)
    assert codes(controller.advance(10 * MS)) == [(7, S_EXECUTING)]
    assert controller.due(10 * MS) is None


# whom


def test_what_was_not_recorded_is_refused_and_counted() -> None:
    controller = played(line(GET, i4(1)))
    assert codes(controller.on_datagram("a", encode_frame(3, 0, 64, [i4(1), bstr("Motor")]), 0)) == [
        (3, E_NOTIMPL)
    ]
    assert controller.unknown_calls == 1


def test_a_refusal_is_refused_again() -> None:
    controller = played(line(GET, i4(1), hresult=E_FAIL, values=()), replies=ReplyReserved.UNKNOWN)
    assert codes(controller.on_datagram("a", get(3), 0)) == [(3, E_FAIL)]


def test_an_answer_that_does_not_fit_a_datagram_is_refused_on_udp() -> None:
    controller = played(line(GET, i4(1), values=(bstr("x" * 300),)), line(GET, i4(1), answer=2))
    assert codes(controller.on_datagram("a", get(3), 0)) == [(3, E_TOO_MUCH_DATA)]
    assert codes(controller.on_datagram("a", get(4), 0)) == [(4, S_OK)]
    controller.on_connect("b", 0)
    assert codes(controller.on_segment("b", get(3), 0)) == [(3, S_OK)]


def test_an_answer_that_was_damaged_cannot_be_given_again() -> None:
    controller = played(line(GET, i4(1), values=(Variant(VT.I4 | ARRAY, (1, 2), 99),)))
    assert codes(controller.on_datagram("a", get(3), 0)) == [(3, E_NOTIMPL)]
    assert controller.unknown_calls == 1


def test_clients_have_a_script_each_and_their_number_is_bounded() -> None:
    controller = played(line(GET, i4(1), answer=1), line(GET, i4(1), answer=2))
    for number in range(MAX_CLIENTS):
        (output,) = controller.on_datagram(number, get(1), number)
        assert Frame(output.data).arguments[0].variant.value == 1
    assert controller.on_datagram("one more", get(1), IDLE_CLIENT_NS - 1) == []
    assert controller.dropped == 1
    assert controller.on_datagram("one more", get(1), IDLE_CLIENT_NS)
    assert controller.on_datagram("yet another", get(1), IDLE_CLIENT_NS) == []
    (output,) = controller.on_datagram(1, get(2), IDLE_CLIENT_NS)
    assert Frame(output.data).arguments[0].variant.value == 2


def test_a_request_that_waits_counts_from_its_arrival() -> None:
    second = 1000 * MS
    controller = played(line(GET, i4(1), duration=second))
    controller.on_datagram(0, get(1), 0)
    controller.on_datagram(0, get(2), 0)
    for number in range(1, MAX_CLIENTS):
        controller.on_datagram(number, get(1), 1)
    assert len(controller.advance(second + 1)) == MAX_CLIENTS
    controller.on_datagram("one more", get(1), IDLE_CLIENT_NS)
    assert controller.dropped == 0
    assert (0, 2) not in [(peer, Frame(data).serial) for peer, data in controller.advance(3 * second)]


def test_clients_of_one_transport_take_no_room_of_the_other() -> None:
    controller = played(line(GET, i4(1)))
    for number in range(MAX_CLIENTS):
        assert controller.on_datagram(number, get(1), 0)
        assert controller.on_connect(("tcp", number), 0)
    assert not controller.on_connect("one more", 0)
    assert controller.on_datagram("another", get(1), IDLE_CLIENT_NS)
    assert codes(controller.on_segment(("tcp", 0), get(1), 0)) == [(1, S_OK)]
    assert len(controller.reset(0)) == MAX_CLIENTS
    assert controller.on_connect("one more", 0)


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_no_bytes_end_it(packets: list[bytes]) -> None:
    controller = played(line(GET, i4(1)))
    controller.on_connect("tcp", 0)
    for packet in packets:
        controller.on_datagram("udp", packet, 0)
        controller.on_segment("tcp", packet, 0)
    assert codes(controller.on_datagram("udp", get(3), 0)) == [(3, S_OK)]


@pytest.mark.parametrize("datagrams", [True, False])
def test_a_session_played_to_its_own_recording_goes_as_recorded(datagrams: bool) -> None:
    script = recorded(motion, datagrams=datagrams)
    controller = RecordedController(script, lambda peer, report: None)
    heard, _ = perform(script, controller, datagrams=datagrams, anywhere=True)
    assert len(heard) == len(script.calls)
    assert not any(each.differs or each.values_differ for each in heard)
    assert controller.unknown_calls == 0
