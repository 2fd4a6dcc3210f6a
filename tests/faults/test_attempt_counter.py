"""Which try a frame is: all conventions, lost packets, copies, and what is long ago."""

from __future__ import annotations

from bcapscope.faults.attempt_counter import AttemptCounter
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.observation import Endpoint, Transport
from bcapscope.traffic.recent_serials import MAX_SERIALS
from tests.faults.traffic import Talk, reply, request, talk


def number(
    attempts: AttemptCounter, flows: Talk, serial: int, reserved: int = 0, command: str = "slvMove"
) -> int | None:
    """Tell which try a request is."""
    return attempts.attempt_number(flows.up, Frame(request(serial, command, reserved)))


def answered(attempts: AttemptCounter, flows: Talk, serial: int) -> int | None:
    """Tell which try a reply answers."""
    return attempts.attempt_number(flows.down, Frame(reply(serial)))


def test_a_retry_whose_first_try_was_lost_counts_from_it() -> None:
    attempts, flows = AttemptCounter(), talk()
    assert number(attempts, flows, 12, 10) == 3
    assert number(attempts, flows, 13, 10) == 4
    assert answered(attempts, flows, 12) == 3
    assert answered(attempts, flows, 10) == 1
    assert number(attempts, flows, 115, 100) == 16
    assert number(attempts, flows, 216, 200) == 2


def test_a_copy_made_by_the_network_is_the_same_try() -> None:
    attempts, flows = AttemptCounter(), talk()
    assert [number(attempts, flows, *each) for each in ((5, 0), (6, 5), (6, 5), (7, 5))] == [1, 2, 2, 3]
    assert [number(attempts, flows, *each) for each in ((1, 0), (2, 1), (2, 1))] == [1, 2, 2]


def test_a_request_without_a_reserved_is_a_new_call_under_any_serial() -> None:
    attempts, flows = AttemptCounter(), talk()
    assert [number(attempts, flows, *each) for each in ((5, 0), (6, 5), (6, 0), (7, 6))] == [1, 2, 1, 2]


def test_another_call_with_the_number_of_an_earlier_one_is_no_retry() -> None:
    attempts, flows = AttemptCounter(), talk()
    number(attempts, flows, 5)
    number(attempts, flows, 6, 5)
    assert number(attempts, flows, 5, 0, "CurJnt") == 1
    assert number(attempts, flows, 7, 6, "CurPos") == 2
    assert answered(attempts, flows, 5) == 1


def test_a_call_of_another_function_is_no_retry() -> None:
    attempts, flows = AttemptCounter(), talk()
    first, other = Frame(encode_frame(5, 0, 0x40, ())), Frame(encode_frame(6, 5, 0x41, ()))
    assert attempts.attempt_number(flows.up, first) == 1
    call = attempts.add_frame(flows.up, other)
    assert call is not None
    assert call.number == call.call.attempts == 2
    assert attempts.find_same_request(flows.up, Frame(encode_frame(5, 0, 0x41, ()))) is call.call
    assert attempts.find_same_request(flows.up, first) is None


def test_each_conversation_counts_for_itself_and_nothing_is_sent_twice_on_tcp() -> None:
    attempts, one, other = AttemptCounter(), talk(), talk(client=Endpoint("10.0.0.9", 1))
    number(attempts, one, 5)
    assert number(attempts, other, 6, 5) == 2
    assert answered(attempts, other, 7) is None
    stream = talk(Transport.TCP)
    assert number(attempts, stream, 6, 5) == 1
    assert answered(attempts, stream, 99) == 1


def test_what_is_long_ago_is_forgotten() -> None:
    attempts, flows = AttemptCounter(), talk()
    for serial in range(1, 2 * MAX_SERIALS + 2):
        number(attempts, flows, serial)
    assert answered(attempts, flows, 1) is None
    assert answered(attempts, flows, 2 * MAX_SERIALS) == 1
    for port in range(MAX_CONVERSATIONS):
        number(attempts, talk(client=Endpoint("10.0.0.9", port)), 1)
    assert answered(attempts, flows, 2 * MAX_SERIALS) is None


def test_tries_of_one_call_and_their_answers_are_known_by_it() -> None:
    attempts, flows = AttemptCounter(), talk()
    first, again, other = (Frame(request(*each)) for each in ((5,), (6, "slvMove", 5), (7, "CurJnt")))
    assert attempts.find_same_request(flows.up, first) is None
    call = attempts.add_frame(flows.up, first)
    assert call is not None
    assert attempts.find_same_request(flows.up, first) is call.call
    retry, another = attempts.add_frame(flows.up, again), attempts.add_frame(flows.up, other)
    assert retry is not None
    assert another is not None
    assert retry.call is call.call
    assert another.call is not call.call
    heard = attempts.add_frame(flows.down, Frame(reply(6)))
    assert heard == retry
    attempts.close_conversation(flows.up.conversation)
    assert attempts.add_frame(flows.down, Frame(reply(6))) is None
