"""Pasted hex as observations, so that it is shown like any other traffic."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.capture.hextext import HexPacket, read_hex_text
from bcapscope.protocol.damage import explain
from bcapscope.protocol.frame import Frame, Malformed, parse_bytes
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)


class Pasted(NamedTuple):
    """What a text holds.

    Attributes:
        observations: a packet each; of their times nothing is known, so all are 0.
        comments: what is to be said of a packet beside its problems, by its number.
    """

    observations: list[Observation]
    comments: dict[int, tuple[str, ...]]


def observe_text(text: str) -> Pasted:
    """Find the packets in a text; nothing is found where it has no hex. Never raises.

    A damaged frame has among its problems what probably happened to it, worded as a guess.
    """
    ends = Endpoint("client", 0), Endpoint("server", 0)
    conversation = Conversation(*ends, Transport.UNKNOWN, "the text")
    flows = {direction: Flow(conversation, direction) for direction in Direction}
    found = Pasted([], {})
    for number, packet in enumerate(read_hex_text(text), 1):
        flow = flows[packet.direction or Direction.REQUEST]
        found.observations.append(Observation(number, 0, 0, flow, _item(packet), number))
        found.comments[number] = _comments(packet)
    return found


def _item(packet: HexPacket) -> Frame | Malformed:
    item = parse_bytes(packet.data)
    if not item.problems and packet.direction is None:
        return item
    asks = None if packet.direction is None else packet.direction is Direction.REQUEST
    cause = explain(packet.data, asks)
    if cause is None:
        return item
    if isinstance(item, Malformed):
        return Malformed(item.raw, (*item.problems, cause))
    return Frame(item.raw, cause)


def _comments(packet: HexPacket) -> tuple[str, ...]:
    comments = [f"line {packet.line}{': ' if packet.caption else ''}{packet.caption}"]
    if packet.direction is None:
        comments.append("nothing tells who sent it, read as a request")
    elif packet.guessed:
        comments.append(f"taken for a {packet.direction} by its bytes")
    return (*comments, *packet.notes)
