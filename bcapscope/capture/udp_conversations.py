"""UDP conversations of a capture. Each datagram holds one or several frames."""

from __future__ import annotations

from collections.abc import Collection

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.role_detection import (
    TimedItem,
    UndecidedConversation,
    endpoints_of,
    is_whole_frames,
    reverse_key,
    server_index_by_port,
)
from bcapscope.protocol.codec.frame import Frame, Malformed, Problem, parse_captured_datagram, parse_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.observation import SERVER_PORT, Flow, Transport

FLOWS_LIMIT = 65536
"""Maximum number of flows. A controller accepts at most twenty clients (orin_bcap
C/src/bCAPServer/bcap_server.c). A client that returns after its flow was dropped begins a new conversation.
"""

UNDECIDED_LIMIT = 1024
"""Maximum number of conversations whose controller is unknown. When another such conversation begins,
bcapscope guesses the controller of the oldest one.
"""


class UdpConversations:
    """All UDP conversations of a capture. Each key of `flows` holds source address, destination address,
    source port and destination port, as in a packet.
    """

    def __init__(
        self, ports: Collection[int], counts: CaptureCounts, templates: FrameTemplates | None = None
    ) -> None:
        """An end whose port is in `ports` is a controller. `counts` counts datagrams that are not b-CAP."""
        self.flows: dict[bytes, Flow] = {}
        self._ports = ports
        self._counts = counts
        self._templates = templates
        self._undecided: dict[bytes, tuple[UndecidedConversation, int]] = {}

    def receive(
        self, addresses: bytes, segment: bytes, arrival: tuple[int, int, int], note: Problem | None
    ) -> list[tuple[Flow, TimedItem]]:
        """Accept a UDP datagram with its 8-byte header. Return all new and held items that now have a flow.

        `arrival` holds the values `began`, `time` and `packet` for each `TimedItem`. `note` is the reason why
        the datagram is incomplete; None for a whole datagram.
        """
        key = addresses + segment[:4]
        payload = segment[8:]
        items = [TimedItem(*arrival, item) for item in self._parse_items(payload, note)]
        flow = self.flows.get(key)
        if flow is not None:
            return [(flow, item) for item in items]
        found: list[tuple[Flow, TimedItem]] = []
        known = self._undecided.get(key)
        if known is None:
            talk = self._begin_conversation(key, payload)
            if talk is None:
                self._counts.not_bcap += 1
                return []
            known = talk, 0
            if len(self._undecided) >= 2 * UNDECIDED_LIMIT:
                found = self._guess_oldest()
            self._undecided[key] = known
            self._undecided[reverse_key(key)] = talk, 1
        talk, sender = known
        for item in items:
            talk.add_item(sender, item)
        return found + self._release_items(key, talk, sender)

    def close(self) -> list[tuple[Flow, TimedItem]]:
        """Guess each unknown controller, and return the items that were held."""
        found: list[tuple[Flow, TimedItem]] = []
        while self._undecided:
            found += self._guess_oldest()
        return found

    def _begin_conversation(self, key: bytes, payload: bytes) -> UndecidedConversation | None:
        source, destination = endpoints_of(key)
        server = server_index_by_port(self._ports, source.port, destination.port)
        talk = UndecidedConversation((source, destination), Transport.UDP)
        if server is not None:
            talk.set_server(server, SERVER_PORT)
        elif source.port not in self._ports and not is_whole_frames(payload):
            return None
        return talk

    def _release_items(
        self, key: bytes, conversation: UndecidedConversation, sender: int
    ) -> list[tuple[Flow, TimedItem]]:
        if conversation.flows is not None:
            other = reverse_key(key)
            # both keys are equal if a forged packet has the same source and destination
            for each in {key, other}:
                del self._undecided[each]
            self.flows[key], self.flows[other] = conversation.flows[sender], conversation.flows[1 - sender]
            while len(self.flows) > FLOWS_LIMIT:
                del self.flows[next(iter(self.flows))]
        return conversation.release_items()

    def _guess_oldest(self) -> list[tuple[Flow, TimedItem]]:
        key, (talk, sender) = next(iter(self._undecided.items()))
        talk.guess_server()
        return self._release_items(key, talk, sender)

    def _parse_items(self, payload: bytes, note: Problem | None) -> tuple[Frame | Malformed, ...]:
        if note is None:
            return parse_captured_datagram(payload, self._templates)
        if not payload:
            return (Malformed(payload, (note,)),)
        *sound, last = parse_datagram(payload, self._templates)
        note = note._replace(offset=len(last.raw))
        if isinstance(last, Malformed):
            return (*sound, Malformed(last.raw, (*last.problems, note)))
        return (*sound, Frame(last.raw, note, self._templates))
