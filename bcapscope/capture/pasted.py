"""Pasted hex as observations, so that it is shown like any other traffic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

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


class Pasted:
    """The packets of a text, in their order. Their times are unknown and set to 0.

    A damaged frame has among its problems what probably happened to it, worded as a guess.

    Attributes:
        count: packets so far.
        comments: comments on the latest packet, by its number, in addition to its problems.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        """Take the lines of the text, which are read while the packets are taken."""
        self.count = 0
        self.comments: dict[int, tuple[str, ...]] = {}
        self._lines = lines

    def __iter__(self) -> Iterator[Observation]:
        """Yield the packets.

        Raises:
            CaptureError: as the lines do.
        """
        ends = Endpoint("client", 0), Endpoint("server", 0)
        conversation = Conversation(*ends, Transport.UNKNOWN, "the text")
        flows = {direction: Flow(conversation, direction) for direction in Direction}
        for number, packet in enumerate(read_hex_text(self._lines), 1):
            flow = flows[packet.direction or Direction.REQUEST]
            self.count = number
            self.comments.clear()
            self.comments[number] = _comments(packet)
            yield Observation(number, 0, 0, flow, _item(packet), number)


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
