"""Ends that talk, and what is kept back until their roles are known."""

from __future__ import annotations

from bcapscope.capture.role_detection import (
    HELD_ITEMS_LIMIT,
    TimedItem,
    UndecidedConversation,
    endpoints_of,
    reverse_key,
)
from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Direction,
    Endpoint,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)
from tests.capture.packets import CLIENT, SERVER, reply, request

ENDS = Endpoint("10.0.0.2", 6000), Endpoint("10.0.0.1", 7000)
DOUBTFUL = Frame(encode_frame(1, 0, 1))


def timed_item(item: Frame | Malformed, packet: int = 1) -> TimedItem:
    return TimedItem(packet, packet, packet, item)


def test_keys_name_the_ends_and_turn_around() -> None:
    key = CLIENT + SERVER + (6000).to_bytes(2) + (7000).to_bytes(2)
    assert endpoints_of(key) == ENDS
    assert endpoints_of(reverse_key(key)) == ENDS[::-1]
    six = bytes(15) + b"\x01" + bytes(15) + b"\x02" + key[-4:]
    assert endpoints_of(six) == (Endpoint("::1", 6000), Endpoint("::2", 7000))
    assert endpoints_of(reverse_key(six)) == (Endpoint("::2", 7000), Endpoint("::1", 6000))


def test_a_decided_talk_gives_out_at_once() -> None:
    talk = UndecidedConversation(ENDS, Transport.UDP)
    talk.set_server(1, SERVER_PORT)
    first, second = timed_item(DOUBTFUL), timed_item(DOUBTFUL, 2)
    assert talk.add_item(0, first)
    assert talk.add_item(1, second)
    (asked, one), (answered, two) = talk.release_items()
    assert (one, two) == (first, second)
    assert (asked.direction, answered.direction) == (Direction.REQUEST, Direction.RESPONSE)
    assert asked.conversation is answered.conversation
    assert (asked.conversation.client, asked.conversation.server) == ENDS
    assert asked.conversation.server_evidence == SERVER_PORT
    assert talk.release_items() == []


def test_doubtful_items_wait_for_proof() -> None:
    for sender, item in ((1, Frame(reply(1))), (0, Frame(request(1)))):
        talk = UndecidedConversation(ENDS, Transport.TCP)
        talk.add_item(1, timed_item(DOUBTFUL))
        assert talk.release_items() == []
        talk.add_item(sender, timed_item(item, 2))
        released = talk.release_items()
        assert [flow.src for flow, _ in released] == [ENDS[1], ENDS[sender]]
        assert {flow.conversation.server for flow, _ in released} == {ENDS[1]}
        kind = ServerEvidenceKind.RESULT if sender else ServerEvidenceKind.CALL
        assert released[0][0].conversation.server_evidence == ServerEvidence(kind, item.code)


def test_without_proof_the_server_is_guessed_and_called_a_guess() -> None:
    talk = UndecidedConversation(ENDS, Transport.UDP)
    for packet in range(HELD_ITEMS_LIMIT):
        assert talk.release_items() == []
        talk.add_item(1, timed_item(DOUBTFUL, packet))
    released = talk.release_items()
    assert len(released) == HELD_ITEMS_LIMIT
    conversation = released[0][0].conversation
    assert conversation.client == ENDS[1]
    assert conversation.server_evidence.kind is ServerEvidenceKind.GUESS


def test_the_end_is_a_guess_too_but_never_overrules() -> None:
    talk = UndecidedConversation(ENDS, Transport.UDP)
    talk.add_item(0, timed_item(DOUBTFUL))
    talk.guess_server()
    assert talk.release_items()[0][0].conversation.client == ENDS[0]
    talk = UndecidedConversation(ENDS, Transport.UDP)
    talk.set_server(0, SERVER_PORT)
    talk.add_item(0, timed_item(DOUBTFUL))
    talk.guess_server()
    assert talk.release_items()[0][0].conversation.server == ENDS[0]


def test_a_tentative_talk_has_to_show_a_sound_frame_first() -> None:
    for item in (Malformed(b"x", ()), Frame(request(1)[:-1] + b"\x05")):
        assert not UndecidedConversation(ENDS, Transport.TCP, is_tentative=True).add_item(0, timed_item(item))
        talk = UndecidedConversation(ENDS, Transport.TCP, is_tentative=True)
        assert talk.add_item(0, timed_item(Frame(request(1))))
        assert talk.add_item(0, timed_item(item))
        assert len(talk.release_items()) == 2
