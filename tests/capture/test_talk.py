"""Ends that talk, and what is kept back until their roles are known."""

from __future__ import annotations

from bcapscope.capture.talk import HELD_LIMIT, Sighting, Talk, endpoints, reverse
from bcapscope.protocol.frame import Frame, Malformed, encode
from bcapscope.traffic.observation import Direction, Endpoint, Transport
from tests.capture.packets import CLIENT, SERVER, reply, request

ENDS = Endpoint("10.0.0.2", 6000), Endpoint("10.0.0.1", 7000)
DOUBTFUL = Frame(encode(1, 0, 1))


def sighting(item: Frame | Malformed, packet: int = 1) -> Sighting:
    return Sighting(packet, packet, packet, item)


def test_keys_name_the_ends_and_turn_around() -> None:
    key = CLIENT + SERVER + (6000).to_bytes(2) + (7000).to_bytes(2)
    assert endpoints(key) == ENDS
    assert endpoints(reverse(key)) == ENDS[::-1]
    six = bytes(15) + b"\x01" + bytes(15) + b"\x02" + key[-4:]
    assert endpoints(six) == (Endpoint("::1", 6000), Endpoint("::2", 7000))
    assert endpoints(reverse(six)) == (Endpoint("::2", 7000), Endpoint("::1", 6000))


def test_a_decided_talk_gives_out_at_once() -> None:
    talk = Talk(ENDS, Transport.UDP)
    talk.decide(1, "port 7000")
    first, second = sighting(DOUBTFUL), sighting(DOUBTFUL, 2)
    assert talk.hear(0, first)
    assert talk.hear(1, second)
    (asked, one), (answered, two) = talk.release()
    assert (one, two) == (first, second)
    assert (asked.direction, answered.direction) == (Direction.REQUEST, Direction.RESPONSE)
    assert asked.conversation is answered.conversation
    assert (asked.conversation.client, asked.conversation.server) == ENDS
    assert asked.conversation.side_known_by == "port 7000"
    assert talk.release() == []


def test_doubtful_items_wait_for_proof() -> None:
    for sender, item in ((1, Frame(reply(1))), (0, Frame(request(1)))):
        talk = Talk(ENDS, Transport.TCP)
        talk.hear(1, sighting(DOUBTFUL))
        assert talk.release() == []
        talk.hear(sender, sighting(item, 2))
        released = talk.release()
        assert [flow.src for flow, _ in released] == [ENDS[1], ENDS[sender]]
        assert {flow.conversation.server for flow, _ in released} == {ENDS[1]}
        assert str(ENDS[sender]) in released[0][0].conversation.side_known_by


def test_without_proof_the_server_is_guessed_and_called_a_guess() -> None:
    talk = Talk(ENDS, Transport.UDP)
    for packet in range(HELD_LIMIT):
        assert talk.release() == []
        talk.hear(1, sighting(DOUBTFUL, packet))
    released = talk.release()
    assert len(released) == HELD_LIMIT
    conversation = released[0][0].conversation
    assert conversation.client == ENDS[1]
    assert conversation.side_known_by.startswith("a guess")


def test_the_end_is_a_guess_too_but_never_overrules() -> None:
    talk = Talk(ENDS, Transport.UDP)
    talk.hear(0, sighting(DOUBTFUL))
    talk.guess()
    assert talk.release()[0][0].conversation.client == ENDS[0]
    talk = Talk(ENDS, Transport.UDP)
    talk.decide(0, "port 6000")
    talk.hear(0, sighting(DOUBTFUL))
    talk.guess()
    assert talk.release()[0][0].conversation.server == ENDS[0]


def test_a_tentative_talk_has_to_show_a_sound_frame_first() -> None:
    for item in (Malformed(b"x", ()), Frame(request(1)[:-1] + b"\x05")):
        assert not Talk(ENDS, Transport.TCP, tentative=True).hear(0, sighting(item))
        talk = Talk(ENDS, Transport.TCP, tentative=True)
        assert talk.hear(0, sighting(Frame(request(1))))
        assert talk.hear(0, sighting(item))
        assert len(talk.release()) == 2
