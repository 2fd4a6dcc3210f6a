"""Which try a frame is: all conventions, lost packets, copies, and what is long ago."""

from __future__ import annotations

from bcapscope.faults.attempts import Attempts
from bcapscope.protocol.frame import Frame
from bcapscope.traffic.observation import Endpoint, Transport
from bcapscope.traffic.question import MOST_CONVERSATIONS, MOST_SERIALS
from tests.faults.traffic import Talk, reply, request, talk


def number(
    attempts: Attempts, flows: Talk, serial: int, reserved: int = 0, command: str = "slvMove"
) -> int | None:
    """Tell which try a request is."""
    return attempts.number(flows.up, Frame(request(serial, command, reserved)))


def answered(attempts: Attempts, flows: Talk, serial: int) -> int | None:
    """Tell which try a reply answers."""
    return attempts.number(flows.down, Frame(reply(serial)))


def test_a_retry_whose_first_try_was_lost_counts_from_it() -> None:
    attempts, flows = Attempts(), talk()
    assert number(attempts, flows, 12, 10) == 3
    assert number(attempts, flows, 13, 10) == 4
    assert answered(attempts, flows, 12) == 3
    assert number(attempts, flows, 5000, 100) == 2


def test_a_copy_made_by_the_network_is_the_same_try() -> None:
    attempts, flows = Attempts(), talk()
    assert [number(attempts, flows, *each) for each in ((5, 0), (6, 5), (6, 5), (7, 5))] == [1, 2, 2, 3]


def test_another_call_with_the_number_of_an_earlier_one_is_no_retry() -> None:
    attempts, flows = Attempts(), talk()
    number(attempts, flows, 5)
    number(attempts, flows, 6, 5)
    assert number(attempts, flows, 5, 0, "CurJnt") == 1
    assert number(attempts, flows, 7, 6, "CurPos") == 2
    assert answered(attempts, flows, 5) == 1


def test_each_conversation_counts_for_itself_and_nothing_is_sent_twice_on_tcp() -> None:
    attempts, one, other = Attempts(), talk(), talk(client=Endpoint("10.0.0.9", 1))
    number(attempts, one, 5)
    assert number(attempts, other, 6, 5) == 2
    assert answered(attempts, other, 7) is None
    stream = talk(Transport.TCP)
    assert number(attempts, stream, 6, 5) == 1
    assert answered(attempts, stream, 99) == 1


def test_what_is_long_ago_is_forgotten() -> None:
    attempts, flows = Attempts(), talk()
    for serial in range(1, 2 * MOST_SERIALS + 2):
        number(attempts, flows, serial)
    assert answered(attempts, flows, 1) is None
    assert answered(attempts, flows, 2 * MOST_SERIALS) == 1
    for port in range(MOST_CONVERSATIONS):
        number(attempts, talk(client=Endpoint("10.0.0.9", port)), 1)
    assert answered(attempts, flows, 2 * MOST_SERIALS) is None


def test_tries_of_one_call_and_their_answers_are_known_by_it() -> None:
    attempts, flows = Attempts(), talk()
    first, again, other = (Frame(request(*each)) for each in ((5,), (6, "slvMove", 5), (7, "CurJnt")))
    assert attempts.asked_before(flows.up, first) is None
    call = attempts.follow(flows.up, first)
    assert call is not None
    assert attempts.asked_before(flows.up, first) is call.call
    retry, another = attempts.follow(flows.up, again), attempts.follow(flows.up, other)
    assert retry is not None
    assert another is not None
    assert retry.call is call.call
    assert another.call is not call.call
    heard = attempts.follow(flows.down, Frame(reply(6)))
    assert heard == retry
    attempts.forget(flows.up.conversation)
    assert attempts.follow(flows.down, Frame(reply(6))) is None
