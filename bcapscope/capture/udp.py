"""UDP datagrams: each is one frame, or several."""

from __future__ import annotations

from collections.abc import Collection

from bcapscope.capture.counts import Counts
from bcapscope.capture.sides import is_datagram, server_by_port
from bcapscope.capture.talk import Sighting, Talk, endpoints, reverse
from bcapscope.protocol.frame import Frame, Malformed, Problem, parse_datagram
from bcapscope.traffic.observation import Flow, Transport

FLOWS_LIMIT = 65536
"""Flows remembered. Clients of one controller are twenty at most (orin_bcap C/src/bcap_server.c); one that
is forgotten and comes again counts as another conversation."""

TALKS_LIMIT = 1024
"""Pairs of ends whose server is not known yet; the oldest is guessed beyond that."""


class Datagrams:
    """All UDP conversations of a capture.

    Attributes:
        flows: by addresses and ports as they stand in a packet: source and destination address, source
            and destination port. Only what is b-CAP, and of which the server is known.
    """

    def __init__(self, ports: Collection[int], counts: Counts) -> None:
        """Take the ports on which servers listen, and where to count what is something else."""
        self.flows: dict[bytes, Flow] = {}
        self._ports = ports
        self._counts = counts
        self._talks: dict[bytes, tuple[Talk, int]] = {}

    def receive(
        self, addresses: bytes, segment: bytes, sighting: Sighting, note: Problem | None
    ) -> list[tuple[Flow, Sighting]]:
        """Take a datagram in and return what is known to have been said by now.

        Args:
            addresses: source and destination.
            segment: the datagram with its header of 8 bytes.
            sighting: when it was seen; its item is not looked at.
            note: why the datagram is not whole, if it is not.
        """
        key = addresses + segment[:4]
        payload = segment[8:]
        items = [sighting._replace(item=item) for item in _items(payload, note)]
        flow = self.flows.get(key)
        if flow is not None:
            return [(flow, item) for item in items]
        found: list[tuple[Flow, Sighting]] = []
        known = self._talks.get(key)
        if known is None:
            talk = self._begin(key, payload)
            if talk is None:
                self._counts.not_bcap += 1
                return []
            known = talk, 0
            found = self._make_room()
            self._talks[key] = known
            self._talks[reverse(key)] = talk, 1
        talk, sender = known
        for item in items:
            talk.hear(sender, item)
        return found + self._release(key, talk, sender)

    def close(self) -> list[tuple[Flow, Sighting]]:
        """End the capture: give out what was held back."""
        found: list[tuple[Flow, Sighting]] = []
        while self._talks:
            found += self._guess_oldest()
        return found

    def _begin(self, key: bytes, payload: bytes) -> Talk | None:
        source, destination = endpoints(key)
        server = server_by_port(self._ports, source.port, destination.port)
        talk = Talk((source, destination), Transport.UDP)
        if server is not None:
            talk.decide(server, f"port {(source, destination)[server].port}")
        elif source.port not in self._ports and not is_datagram(payload):
            return None
        return talk

    def _release(self, key: bytes, talk: Talk, sender: int) -> list[tuple[Flow, Sighting]]:
        if talk.flows is not None:
            other = reverse(key)
            for each in {key, other}:  # the same where a forged packet goes to its own sender
                del self._talks[each]
            self.flows[key], self.flows[other] = talk.flows[sender], talk.flows[1 - sender]
            while len(self.flows) > FLOWS_LIMIT:
                del self.flows[next(iter(self.flows))]
        return talk.release()

    def _make_room(self) -> list[tuple[Flow, Sighting]]:
        return self._guess_oldest() if len(self._talks) >= 2 * TALKS_LIMIT else []

    def _guess_oldest(self) -> list[tuple[Flow, Sighting]]:
        key, (talk, sender) = next(iter(self._talks.items()))
        talk.guess()
        return self._release(key, talk, sender)


def _items(payload: bytes, note: Problem | None) -> tuple[Frame | Malformed, ...]:
    if note is None:
        return parse_datagram(payload)
    if not payload:
        return (Malformed(payload, (note,)),)
    *sound, last = parse_datagram(payload)
    note = note._replace(offset=len(last.raw))
    if isinstance(last, Malformed):
        return (*sound, Malformed(last.raw, (*last.problems, note)))
    return (*sound, Frame(last.raw, note))
