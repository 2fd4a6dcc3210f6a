"""Which of the waiting requests of a leaving client are still sent."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
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


@pytest.mark.parametrize("length", [40, 10_000])
def test_the_rest_of_a_frame_is_sent_before_a_stop_although_it_looks_like_a_frame(length: int) -> None:
    looks = b"\x01" + length.to_bytes(4, "little") + bytes(8) + b"\x01\0" + bytes(24) + b"\x04"
    whole = encode_frame(1, 0, 64, (Variant.array(VT.UI1, looks),))
    rest = whole[whole.index(looks) :]
    state = DirectionState(1, talk(Transport.TCP).up, 0, ByteBudget())
    going, lost = split_held_requests(state, [rest, request(2), HALT, request(3)])
    assert b"".join(going) == rest + HALT
    assert lost == [Frame(request(2)), Frame(request(3))]


def test_nothing_held_is_nothing_to_send() -> None:
    assert split_held_requests(DirectionState(1, talk(Transport.TCP).up, 0, ByteBudget()), []) == ([], [])
