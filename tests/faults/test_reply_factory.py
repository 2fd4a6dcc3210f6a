"""Answers in the server's place: their numbers, and what is learnt of the server's own."""

from __future__ import annotations

import pytest

from bcapscope.faults.reply_factory import ReplyFactory, encode_reply
from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame
from bcapscope.protocol.tables.hresult import E_FAIL
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.observation import Endpoint
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
    answer = Frame(encode_reply(Frame(encode_frame(7, reserved, 64, framing=asked)), reserved, E_FAIL))
    assert (answer.serial, answer.reserved, answer.code, answer.argc) == (7, reserved, E_FAIL, 0)
    assert (answer.framing, answer.problems) == (framing, ())


def test_the_servers_own_manners_are_learnt_and_forgotten() -> None:
    manners, flows = ReplyFactory(), talk()
    conversation, asked = flows.up.conversation, Frame(request(6, reserved=5))

    def reserved() -> int:
        found: int = Frame(manners.make_reply(conversation, asked, E_FAIL)).reserved
        return found

    assert reserved() == 0
    manners.on_message(flows.up, request(6, reserved=5))
    manners.on_message(flows.down, reply(9, reserved=5))  # answers another request
    manners.on_message(flows.down, reply(6, reserved=77))  # neither of the two ways
    manners.on_message(flows.down, b"\x01")
    assert reserved() == 0
    manners.on_message(flows.down, reply(6, reserved=5))
    assert reserved() == 5
    manners.on_message(flows.down, reply(6, reserved=0))
    assert reserved() == 0
    manners.on_message(flows.down, reply(6, reserved=5))
    manners.on_message(flows.up, request(7))
    manners.on_message(flows.down, reply(7))  # an answer to a request with 0 shows nothing
    assert reserved() == 5
    manners.close_conversation(conversation)
    assert reserved() == 0
    manners.on_message(flows.down, reply(6, reserved=5))  # answers a request of before
    assert reserved() == 0


def test_the_servers_manners_are_learnt_from_the_shortest_frames() -> None:
    manners, flows = ReplyFactory(), talk()
    manners.on_message(flows.up, encode_frame(6, 5, 64))
    manners.on_message(flows.down, encode_frame(6, 5, 0))
    raw = manners.make_reply(flows.up.conversation, Frame(request(8, reserved=7)), E_FAIL)
    assert Frame(raw).reserved == 7


def test_only_so_many_servers_are_remembered() -> None:
    manners = ReplyFactory()
    first = talk()
    others = [talk(client=Endpoint("10.0.0.9", port)) for port in range(MAX_CONVERSATIONS)]
    for flows in (first, *others):
        manners.on_message(flows.up, request(6, reserved=5))
        manners.on_message(flows.down, reply(6, reserved=5))
    asked = Frame(request(6, reserved=5))
    assert Frame(manners.make_reply(first.up.conversation, asked, E_FAIL)).reserved == 0
    for flows in others:
        assert Frame(manners.make_reply(flows.up.conversation, asked, E_FAIL)).reserved == 5
