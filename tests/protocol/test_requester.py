"""Playbooks of calls: what is sent, what comes, when it wakes, and what is told of it. Times in ms."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.errors import Arrival, Attempt, LocalProtocolError
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import Frame, Malformed, encode, parse_datagram
from bcapscope.protocol.hresult import E_HANDLE, S_BUF_FULL, S_EXECUTING, S_OK
from bcapscope.protocol.requester import (
    Answered,
    Event,
    Executing,
    Late,
    Pace,
    Refused,
    Requester,
    Settled,
    Stray,
    TimedOut,
)
from bcapscope.protocol.variant import VT, Variant

MS = 1_000_000
PACE = Pace(2 * MS, 3)
_UDP = [Convention.SEED, Convention.OWN, Convention.CHAIN]


def _reply(serial: int, code: int = S_OK) -> Frame:
    return Frame(encode(serial, 0, code))


def _sent(requester: Requester) -> list[tuple[int, int]]:
    """Return serial and reserved of what is to be sent now."""
    return [(frame.serial, frame.reserved) for frame in map(Frame, requester.data_to_send())]


def _calling(convention: Convention = Convention.SEED, first_serial: int = 1, pace: Pace = PACE) -> Requester:
    requester = Requester(convention, first_serial)
    requester.call(19, (Variant(VT.I4, 7),), pace, 0)
    return requester


@pytest.mark.parametrize(
    ("convention", "first", "sent"),
    [
        (Convention.SEED, 0x04D0, [(0x04D0, 0), (0x04D1, 0x04D0), (0x04D2, 0x04D0), (0x04D3, 0x04D0)]),
        (Convention.OWN, 9, [(9, 9), (10, 9), (11, 9), (12, 9)]),
        (Convention.CHAIN, 9, [(9, 0), (10, 9), (11, 10), (12, 11)]),
        (Convention.SEED, 65534, [(65534, 0), (65535, 65534), (1, 65534), (2, 65534)]),
        (Convention.CHAIN, 65535, [(65535, 0), (1, 65535), (2, 1), (3, 2)]),
        (Convention.TCP0, 9, [(9, 0)]),
        (Convention.TCP1, 9, [(9, 1)]),
    ],
)
def test_tries_until_the_time_is_over(
    convention: Convention, first: int, sent: list[tuple[int, int]]
) -> None:
    requester = _calling(convention, first)
    tries = _sent(requester)
    while requester.due is not None:
        requester.wake(requester.due)
        tries += _sent(requester)
    assert tries == sent
    attempts = tuple(Attempt(serial, reserved, 2 * MS * i) for i, (serial, reserved) in enumerate(sent))
    assert requester.events() == [TimedOut(attempts)]
    assert not requester.calling


def test_the_packet_of_a_retry_differs_in_serial_and_reserved_only() -> None:
    requester = _calling()
    assert requester.data_to_send() == [encode(1, 0, 19, (Variant(VT.I4, 7),))]
    requester.wake(2 * MS)
    assert requester.data_to_send() == [encode(2, 1, 19, (Variant(VT.I4, 7),))]


def test_too_early_to_wake() -> None:
    requester = _calling()
    _sent(requester)
    requester.wake(2 * MS - 1)
    assert (_sent(requester), requester.events(), requester.due) == ([], [], 2 * MS)


@pytest.mark.parametrize("code", [S_OK, S_BUF_FULL, 1])
def test_a_success_is_an_answer(code: int) -> None:
    requester = _calling()
    reply = _reply(1, code)
    requester.receive(reply, MS)
    (event,) = requester.events()
    assert isinstance(event, Answered)
    assert event.reply is reply
    assert [attempt.serial for attempt in event.attempts] == [1]
    assert (requester.due, requester.calling) == (None, False)


def test_a_failure_is_a_refusal() -> None:
    requester = _calling()
    requester.receive(_reply(1, E_HANDLE), MS)
    refused = Refused(_reply(1, E_HANDLE), (Attempt(1, 0, 0, (Arrival(MS, "E_HANDLE"),)),))
    assert requester.events() == [refused]
    assert refused.took == MS


def test_only_the_reply_to_the_last_try_counts() -> None:
    """The story of the slides: the reply to the first retry is discarded, that to the third is taken."""
    requester = _calling(first_serial=0x04D0)
    for now in (2, 4, 6):
        requester.wake(now * MS)
    requester.receive(_reply(0x04D1), 7 * MS)
    requester.receive(_reply(0x04D3), 8 * MS - 1)
    late, answered = requester.events()
    assert late == Late(_reply(0x04D1), 7 * MS, 2 * MS)
    assert isinstance(answered, Answered)
    assert [len(attempt.came) for attempt in answered.attempts] == [0, 1, 0, 1]
    assert answered.took == 8 * MS - 1


def test_still_executing_begins_the_wait_again() -> None:
    requester = _calling()
    notice = _reply(1, S_EXECUTING)
    requester.receive(notice, MS)
    assert requester.events() == [Executing(notice)]
    assert requester.due == 3 * MS
    requester.receive(_reply(1), 3 * MS - 1)
    assert isinstance(requester.events()[0], Answered)


def test_a_notice_for_an_earlier_try_is_late() -> None:
    requester = _calling()
    requester.wake(2 * MS)
    requester.receive(_reply(1, S_EXECUTING), 3 * MS)
    assert requester.events() == [Late(_reply(1, S_EXECUTING), 3 * MS, 0)]
    assert requester.due == 4 * MS


def test_replies_to_calls_that_are_over_are_late() -> None:
    requester = _calling()
    requester.receive(_reply(1), MS)
    requester.receive(_reply(1), 2 * MS)
    requester.call(20, (), PACE, 3 * MS)
    requester.receive(_reply(1), 4 * MS)
    answered, *late = requester.events()
    assert isinstance(answered, Answered)
    assert late == [Late(_reply(1), 2 * MS, 0), Late(_reply(1), 4 * MS, 0)]
    assert requester.calling


@pytest.mark.parametrize("raw", [_reply(1).raw[:-1], _reply(1).raw[:15], _reply(1).raw[:-1] + b"\0"])
def test_a_reply_that_is_cut_is_no_answer(raw: bytes) -> None:
    requester = _calling()
    requester.receive(Frame(raw), MS)
    assert requester.events() == [Stray(Frame(raw), MS)]
    assert requester.calling


def test_what_nobody_asked_for_is_told() -> None:
    requester = _calling()
    (junk,) = parse_datagram(b"junk")
    requester.receive(_reply(77), MS)
    requester.receive(junk, MS)
    assert requester.events() == [Stray(_reply(77), MS), Stray(junk, MS)]
    assert isinstance(junk, Malformed)
    assert requester.calling


def test_what_the_system_says_is_kept_with_the_try() -> None:
    requester = _calling(pace=Pace(2 * MS, 0))
    requester.trouble("port unreachable", MS)
    requester.wake(2 * MS)
    assert requester.events() == [TimedOut((Attempt(1, 0, 0, (Arrival(MS, "port unreachable"),)),))]
    requester.trouble("port unreachable", 3 * MS)
    assert requester.events() == []


def test_a_call_that_is_given_up_leaves_room_for_the_next() -> None:
    requester = _calling()
    assert requester.abandon() == (Attempt(1, 0, 0),)
    requester.wake(9 * MS)
    requester.call(20, (), PACE, 9 * MS)
    assert _sent(requester) == [(1, 0), (2, 0)]
    requester.receive(_reply(1), 9 * MS)
    assert requester.events() == [Late(_reply(1), 9 * MS, 0)]


def test_one_call_at_a_time() -> None:
    requester = _calling()
    with pytest.raises(LocalProtocolError, match="under way"):
        requester.call(20, (), PACE, 0)
    assert len(requester.data_to_send()) == 1


@pytest.mark.parametrize("convention", _UDP)
def test_a_packet_of_503_bytes_is_the_largest_on_udp(convention: Convention) -> None:
    fits = Variant.array(VT.UI1, bytes(503 - 26))
    requester = Requester(convention)
    requester.call(52, (fits,), PACE, 0)
    assert len(requester.data_to_send()[0]) == 503
    other = Requester(convention)
    with pytest.raises(LocalProtocolError, match=r"File_GetValue .* 504 bytes.* 503: connect over TCP"):
        other.call(52, (Variant.array(VT.UI1, bytes(504 - 26)),), PACE, 0)
    assert (other.data_to_send(), other.calling) == ([], False)


def test_tcp_takes_large_packets() -> None:
    requester = Requester(Convention.TCP0)
    requester.call(53, (Variant.array(VT.UI1, bytes(5000)),), PACE, 0)
    assert len(requester.data_to_send()[0]) == 5026


@pytest.mark.parametrize(
    ("convention", "serial"), [(Convention.UNKNOWN, 1), (Convention.SEED, 0), (Convention.SEED, 65536)]
)
def test_what_makes_no_sense(convention: Convention, serial: int) -> None:
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


@given(st.sampled_from([*_UDP, Convention.TCP0]), st.sampled_from([1, 65533]), _ACTIONS)
def test_every_call_ends_in_exactly_one_way(
    convention: Convention, first: int, actions: list[tuple[str, int]]
) -> None:
    requester = _calling(convention, first)
    codes = {"answer": S_OK, "refuse": E_HANDLE, "notice": S_EXECUTING}
    last, now = first, 0
    events: list[Event] = []
    serials: list[int] = []
    for action, number in [*actions, *[("wait", 2 * MS)] * 5]:
        if action == "wait":
            now += number
            requester.wake(now)
        elif action == "junk":
            requester.receive(parse_datagram(bytes(number))[0], now)
        else:
            requester.receive(_reply((last + number) % 65536, codes[action]), now)
        new = [serial for serial, _ in _sent(requester)]
        serials += new
        last = new[-1] if new else last
        events += requester.events()
    settled = [event for event in events if isinstance(event, Settled)]
    assert len(settled) == 1
    assert not requester.calling
    assert [attempt.serial for attempt in settled[0].attempts] == serials
    assert len(serials) <= (4 if convention is not Convention.TCP0 else 1)
    assert len(set(serials)) == len(serials)
    assert 0 not in serials
