"""Playbooks of calls: what is sent, what comes, when it wakes, and what is told of it. Times in ms."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.errors import Attempt, AttemptEvent, LocalProtocolError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallExecuting,
    CallRefused,
    CallTimedOut,
    LateReply,
    Requester,
    RequesterEvent,
    RequesterOutcome,
    RetryPolicy,
)
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.tables.hresult import E_HANDLE, S_BUF_FULL, S_EXECUTING, S_OK

MS = 1_000_000
_UNREACHABLE = Message("connection.link-closed")
PACE = RetryPolicy(2 * MS, 3)
_UDP = [ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN]


def _reply(serial: int, code: int = S_OK) -> Frame:
    return Frame(encode_frame(serial, 0, code))


def _sent(requester: Requester) -> list[tuple[int, int]]:
    """Return serial and reserved of what is to be sent now."""
    return [(frame.serial, frame.reserved) for frame in map(Frame, requester.data_to_send())]


def _calling(
    convention: ReservedConvention = ReservedConvention.SEED, first_serial: int = 1, pace: RetryPolicy = PACE
) -> Requester:
    requester = Requester(convention, first_serial)
    requester.start_call(19, (Variant(VT.I4, 7),), pace, 0)
    return requester


@pytest.mark.parametrize(
    ("convention", "first", "sent"),
    [
        (
            ReservedConvention.SEED,
            0x04D0,
            [(0x04D0, 0), (0x04D1, 0x04D0), (0x04D2, 0x04D0), (0x04D3, 0x04D0)],
        ),
        (ReservedConvention.OWN, 9, [(9, 9), (10, 9), (11, 9), (12, 9)]),
        (ReservedConvention.CHAIN, 9, [(9, 0), (10, 9), (11, 10), (12, 11)]),
        (ReservedConvention.SEED, 65534, [(65534, 0), (65535, 65534), (1, 65534), (2, 65534)]),
        (ReservedConvention.CHAIN, 65535, [(65535, 0), (1, 65535), (2, 1), (3, 2)]),
        (ReservedConvention.TCP0, 9, [(9, 0)]),
        (ReservedConvention.TCP1, 9, [(9, 1)]),
    ],
)
def test_tries_until_the_time_is_over(
    convention: ReservedConvention, first: int, sent: list[tuple[int, int]]
) -> None:
    requester = _calling(convention, first)
    tries = _sent(requester)
    while requester.deadline is not None:
        requester.handle_timeout(requester.deadline)
        tries += _sent(requester)
    assert tries == sent
    attempts = tuple(Attempt(serial, reserved, 2 * MS * i) for i, (serial, reserved) in enumerate(sent))
    assert requester.drain_events() == [CallTimedOut(attempts)]
    assert not requester.call_in_progress


def test_the_packet_of_a_retry_differs_in_serial_and_reserved_only() -> None:
    requester = _calling()
    assert requester.data_to_send() == [encode_frame(1, 0, 19, (Variant(VT.I4, 7),))]
    requester.handle_timeout(2 * MS)
    assert requester.data_to_send() == [encode_frame(2, 1, 19, (Variant(VT.I4, 7),))]


def test_too_early_to_wake() -> None:
    requester = _calling()
    _sent(requester)
    requester.handle_timeout(2 * MS - 1)
    assert (_sent(requester), requester.drain_events(), requester.deadline) == ([], [], 2 * MS)


@pytest.mark.parametrize("code", [S_OK, S_BUF_FULL, 1])
def test_a_success_is_an_answer(code: int) -> None:
    requester = _calling()
    reply = _reply(1, code)
    requester.receive_item(reply, MS)
    (event,) = requester.drain_events()
    assert isinstance(event, CallAnswered)
    assert event.reply is reply
    assert [attempt.serial for attempt in event.attempts] == [1]
    assert (requester.deadline, requester.call_in_progress) == (None, False)


def test_a_failure_is_a_refusal() -> None:
    requester = _calling()
    requester.receive_item(_reply(1, E_HANDLE), MS)
    refused = CallRefused(_reply(1, E_HANDLE), (Attempt(1, 0, 0, (AttemptEvent(MS, "E_HANDLE"),)),))
    assert requester.drain_events() == [refused]
    assert refused.elapsed == MS


def test_only_the_reply_to_the_last_try_counts() -> None:
    """The story of the slides: the reply to the first retry is discarded, that to the third is taken."""
    requester = _calling(first_serial=0x04D0)
    for now in (2, 4, 6):
        requester.handle_timeout(now * MS)
    requester.receive_item(_reply(0x04D1), 7 * MS)
    requester.receive_item(_reply(0x04D3), 8 * MS - 1)
    late, answered = requester.drain_events()
    assert late == LateReply(_reply(0x04D1), 7 * MS, 2 * MS)
    assert isinstance(answered, CallAnswered)
    assert [len(attempt.events) for attempt in answered.attempts] == [0, 1, 0, 1]
    assert answered.elapsed == 8 * MS - 1


def test_still_executing_begins_the_wait_again() -> None:
    requester = _calling()
    notice = _reply(1, S_EXECUTING)
    requester.receive_item(notice, MS)
    assert requester.drain_events() == [CallExecuting(notice)]
    assert requester.deadline == 3 * MS
    requester.receive_item(_reply(1), 3 * MS - 1)
    assert isinstance(requester.drain_events()[0], CallAnswered)


def test_a_notice_for_an_earlier_try_is_late() -> None:
    requester = _calling()
    requester.handle_timeout(2 * MS)
    requester.receive_item(_reply(1, S_EXECUTING), 3 * MS)
    assert requester.drain_events() == [LateReply(_reply(1, S_EXECUTING), 3 * MS, 0)]
    assert requester.deadline == 4 * MS


def test_replies_to_calls_that_are_over_are_late() -> None:
    requester = _calling()
    requester.receive_item(_reply(1), MS)
    requester.receive_item(_reply(1), 2 * MS)
    requester.start_call(20, (), PACE, 3 * MS)
    requester.receive_item(_reply(1), 4 * MS)
    answered, *late = requester.drain_events()
    assert isinstance(answered, CallAnswered)
    assert late == [LateReply(_reply(1), 2 * MS, 0), LateReply(_reply(1), 4 * MS, 0)]
    assert requester.call_in_progress


@pytest.mark.parametrize("raw", [_reply(1).raw[:-1], _reply(1).raw[:15], _reply(1).raw[:-1] + b"\0"])
def test_a_reply_that_is_cut_is_no_answer(raw: bytes) -> None:
    requester = _calling()
    requester.receive_item(Frame(raw), MS)
    assert requester.drain_events() == []
    assert requester.call_in_progress


def test_what_nobody_asked_for_is_ignored() -> None:
    requester = _calling()
    (junk,) = parse_datagram(b"junk")
    requester.receive_item(_reply(77), MS)
    requester.receive_item(junk, MS)
    assert requester.drain_events() == []
    assert isinstance(junk, Malformed)
    assert requester.call_in_progress


def test_what_the_system_says_is_kept_with_the_try() -> None:
    requester = _calling(pace=RetryPolicy(2 * MS, 0))
    requester.record_send_error(_UNREACHABLE, MS)
    requester.handle_timeout(2 * MS)
    assert requester.drain_events() == [CallTimedOut((Attempt(1, 0, 0, (AttemptEvent(MS, _UNREACHABLE),)),))]
    requester.record_send_error(_UNREACHABLE, 3 * MS)
    assert requester.drain_events() == []


def test_an_error_of_the_system_belongs_to_the_newest_try() -> None:
    requester = _calling(pace=RetryPolicy(2 * MS, 1))
    requester.handle_timeout(2 * MS)
    requester.record_send_error(_UNREACHABLE, 3 * MS)
    requester.handle_timeout(4 * MS)
    (timed_out,) = requester.drain_events()
    assert isinstance(timed_out, CallTimedOut)
    assert [attempt.events for attempt in timed_out.attempts] == [(), (AttemptEvent(3 * MS, _UNREACHABLE),)]


def test_the_time_of_a_call_counts_from_its_first_try() -> None:
    requester = Requester(ReservedConvention.SEED)
    requester.start_call(19, (), PACE, 5 * MS)
    requester.receive_item(_reply(1, S_EXECUTING), 6 * MS)
    requester.handle_timeout(8 * MS)
    requester.receive_item(_reply(2, S_EXECUTING), 8 * MS + 1)
    requester.receive_item(_reply(2), 9 * MS)
    answered = requester.drain_events()[-1]
    assert isinstance(answered, CallAnswered)
    assert answered.elapsed == 4 * MS


def test_a_call_that_is_given_up_leaves_room_for_the_next() -> None:
    requester = _calling()
    assert requester.abandon() == (Attempt(1, 0, 0),)
    requester.handle_timeout(9 * MS)
    requester.start_call(20, (), PACE, 9 * MS)
    assert _sent(requester) == [(1, 0), (2, 0)]
    requester.receive_item(_reply(1), 9 * MS)
    assert requester.drain_events() == [LateReply(_reply(1), 9 * MS, 0)]


def test_one_call_at_a_time() -> None:
    requester = _calling()
    with pytest.raises(LocalProtocolError, match="in progress"):
        requester.start_call(20, (), PACE, 0)
    assert len(requester.data_to_send()) == 1


@pytest.mark.parametrize("convention", _UDP)
def test_a_packet_of_503_bytes_is_the_largest_on_udp(convention: ReservedConvention) -> None:
    fits = Variant.array(VT.UI1, bytes(503 - 26))
    requester = Requester(convention)
    requester.start_call(52, (fits,), PACE, 0)
    assert len(requester.data_to_send()[0]) == 503
    other = Requester(convention)
    with pytest.raises(LocalProtocolError, match=r"File_GetValue .* 504 bytes.* 503\. Connect over TCP"):
        other.start_call(52, (Variant.array(VT.UI1, bytes(504 - 26)),), PACE, 0)
    assert (other.data_to_send(), other.call_in_progress) == ([], False)


def test_tcp_takes_large_packets() -> None:
    requester = Requester(ReservedConvention.TCP0)
    requester.start_call(53, (Variant.array(VT.UI1, bytes(5000)),), PACE, 0)
    assert len(requester.data_to_send()[0]) == 5026


@pytest.mark.parametrize(
    ("convention", "serial"),
    [(ReservedConvention.UNKNOWN, 1), (ReservedConvention.SEED, 0), (ReservedConvention.SEED, 65536)],
)
def test_what_makes_no_sense(convention: ReservedConvention, serial: int) -> None:
    with pytest.raises(ValueError, match="convention"):
        Requester(convention, serial)


_ACTIONS = st.lists(
    st.one_of(
        st.tuples(st.just("wait"), st.integers(0, 3 * MS)),
        st.tuples(st.sampled_from(["answer", "refuse", "notice"]), st.integers(-4, 1)),
        st.tuples(st.just("junk"), st.integers(0, 9)),
    ),
    max_size=40,
)


@given(st.sampled_from([*_UDP, ReservedConvention.TCP0]), st.sampled_from([1, 65533]), _ACTIONS)
def test_every_call_ends_in_exactly_one_way(
    convention: ReservedConvention, first: int, actions: list[tuple[str, int]]
) -> None:
    requester = _calling(convention, first)
    codes = {"answer": S_OK, "refuse": E_HANDLE, "notice": S_EXECUTING}
    last, now = first, 0
    events: list[RequesterEvent] = []
    serials: list[int] = []
    for action, number in [*actions, *[("wait", 2 * MS)] * 5]:
        if action == "wait":
            now += number
            requester.handle_timeout(now)
        elif action == "junk":
            requester.receive_item(parse_datagram(bytes(number))[0], now)
        else:
            requester.receive_item(_reply((last + number) % 65536, codes[action]), now)
        new = [serial for serial, _ in _sent(requester)]
        serials += new
        last = new[-1] if new else last
        events += requester.drain_events()
    settled = [event for event in events if isinstance(event, RequesterOutcome)]
    assert len(settled) == 1
    assert not requester.call_in_progress
    assert [attempt.serial for attempt in settled[0].attempts] == serials
    assert len(serials) <= (4 if convention is not ReservedConvention.TCP0 else 1)
    assert len(set(serials)) == len(serials)
    assert 0 not in serials
