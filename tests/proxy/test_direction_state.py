"""Which of the waiting requests of a leaving client are still sent."""

from __future__ import annotations

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.proxy.direction_state import DirectionState, split_held_requests
from bcapscope.traffic.observation import Transport
from tests.faults.traffic import request, talk
from tests.proxy.test_rule_policy import HALT


def sent(*held: bytes) -> bytes:
    """Return the bytes of a stream that are sent although their client leaves."""
    state = DirectionState(1, talk(Transport.TCP).up, 0, ByteBudget())
    going, _lost = split_held_requests(state, held)
    return b"".join(going)


def test_a_stop_is_sent_without_the_motion_and_the_garbage_before_it() -> None:
    assert sent(request(1), b"garbage", HALT) == HALT


def test_a_stop_is_sent_after_the_rest_of_a_frame_that_has_begun() -> None:
    rest = request(1)[20:]
    assert sent(rest, request(2), HALT) == rest + HALT


def test_nothing_is_sent_without_a_stop() -> None:
    assert sent(request(1)[20:], request(2)) == b""
