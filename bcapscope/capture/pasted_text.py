"""Turn pasted hex into observations, so that bcapscope shows the text like any other traffic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bcapscope.capture.hex_text import HexPacket, read_hex_text
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_single_frame
from bcapscope.protocol.dissection.repair_text import damage_problem
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)


class PastedText:
    """Observations of the packets in a text, in the order of the text. Their times are unknown and set to 0.

    The problems of a damaged frame include the probable cause of the damage, worded as a guess.

    Attributes:
        count: Number of packets read so far.
        comments: Comments on the latest packet, by packet number.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        """Store the iterable of lines; iteration over the `PastedText` reads the lines."""
        self.count = 0
        self.comments: dict[int, tuple[str, ...]] = {}
        self._lines = lines

    def __iter__(self) -> Iterator[Observation]:
        """Yield the packets.

        Raises:
            CaptureError: The iterable of lines raised it.
        """
        ends = Endpoint("client", 0), Endpoint("server", 0)
        conversation = Conversation(*ends, Transport.UNKNOWN, "the text")
        flows = {direction: Flow(conversation, direction) for direction in Direction}
        for number, packet in enumerate(read_hex_text(self._lines), 1):
            flow = flows[packet.direction or Direction.REQUEST]
            self.count = number
            self.comments.clear()
            self.comments[number] = _packet_comments(packet)
            yield Observation(number, 0, 0, flow, _decode_packet(packet), number)


def _decode_packet(packet: HexPacket) -> Frame | Malformed:
    item = parse_single_frame(packet.data)
    if not item.problems and packet.direction is None:
        return item
    asks = None if packet.direction is None else packet.direction is Direction.REQUEST
    cause = damage_problem(packet.data, asks)
    if cause is None:
        return item
    if isinstance(item, Malformed):
        return Malformed(item.raw, (*item.problems, cause))
    return Frame(item.raw, cause)


def _packet_comments(packet: HexPacket) -> tuple[str, ...]:
    comments = [f"line {packet.line}{': ' if packet.caption else ''}{packet.caption}"]
    if packet.direction is None:
        comments.append("direction unknown, decoded as a request")
    elif packet.is_direction_guessed:
        comments.append(f"taken for a {packet.direction} by its bytes")
    return (*comments, *packet.notes)
