"""Answers in the server's place: their numbers, and what is learnt of the server's own."""

from __future__ import annotations

import pytest

from bcapscope.faults.answers import Manners, reply_to
from bcapscope.protocol.frame import Frame, Framing, encode
from bcapscope.protocol.hresult import E_FAIL
from bcapscope.traffic.observation import Endpoint
from bcapscope.traffic.question import MOST_CONVERSATIONS
from tests.faults.traffic import reply, request, talk


@pytest.mark.parametrize(
    ("asked", "framing"),
    [
        (Framing.PLAIN, Framing.PLAIN),
        (Framing.SERIAL_LINE, Framing.SERIAL_LINE),
        (Framing.VERSION_1, Framing.VERSION_1),
        (Framing.VERSION_1_ZLIB, Framing.VERSION_1),
    ],
)
def test_an_answer_is_framed_as_the_request(asked: Framing, framing: Framing) -> None:
    reserved = 1 if asked in (Framing.VERSION_1, Framing.VERSION_1_ZLIB) else 4
    answer = Frame(reply_to(Frame(encode(7, reserved, 64, framing=asked)), reserved, E_FAIL))
    assert (answer.serial, answer.reserved, answer.code, answer.argc) == (7, reserved, E_FAIL, 0)
    assert (answer.framing, answer.problems) == (framing, ())


def test_the_servers_own_manners_are_learnt_and_forgotten() -> None:
    manners, flows = Manners(), talk()
    conversation, asked = flows.up.conversation, Frame(request(6, reserved=5))

    def reserved() -> int:
        found: int = Frame(manners.answer(conversation, asked, E_FAIL)).reserved
        return found

    assert reserved() == 0
    manners.see(flows.up, request(6, reserved=5))
    manners.see(flows.down, reply(9, reserved=5))  # answers another request
    manners.see(flows.down, reply(6, reserved=77))  # neither of the two ways
    manners.see(flows.down, b"\x01")
    assert reserved() == 0
    manners.see(flows.down, reply(6, reserved=5))
    assert reserved() == 5
    manners.see(flows.down, reply(6, reserved=0))
    assert reserved() == 0
    manners.see(flows.down, reply(6, reserved=5))
    manners.forget(conversation)
    assert reserved() == 0


def test_only_so_many_servers_are_remembered() -> None:
    manners = Manners()
    first = talk()
    for flows in (first, *(talk(client=Endpoint("10.0.0.9", port)) for port in range(MOST_CONVERSATIONS))):
        manners.see(flows.up, request(6, reserved=5))
        manners.see(flows.down, reply(6, reserved=5))
    asked = Frame(request(6, reserved=5))
    assert Frame(manners.answer(first.up.conversation, asked, E_FAIL)).reserved == 0
    assert Frame(manners.answer(flows.up.conversation, asked, E_FAIL)).reserved == 5
