"""TCP connections: whose they are, and what is said in them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection

from bcapscope.capture.counts import Counts
from bcapscope.capture.sides import begins_frame, server_by_port
from bcapscope.capture.talk import Sighting, Talk, endpoints, reverse
from bcapscope.capture.tcp import FIN, RST, SYN, Connection, Segment
from bcapscope.protocol.budget import Budget
from bcapscope.protocol.frame import SMALLEST_FRAME, Frame
from bcapscope.traffic.observation import Flow, Transport

CONNECTIONS_LIMIT = 1024
"""Connections followed at a time; beyond that the one that was silent longest is taken to have ended."""


class _Call:
    """A connection with what is known of its ends; the first key is that of the sender 0.

    There is one key only where a forged packet has the same source and destination.
    """

    __slots__ = ("connection", "doubtful", "ends", "keys", "talk")

    def __init__(self, key: bytes, budget: Budget) -> None:
        self.keys = (key, reverse(key)) if key != reverse(key) else (key,)
        self.ends = endpoints(key)
        self.connection = Connection(budget)
        self.talk: Talk | None = None
        self.doubtful = 0  # segments taken in before it was sure that they are b-CAP


class Connections:
    """All TCP conversations of a capture."""

    def __init__(self, ports: Collection[int], counts: Counts) -> None:
        """Take the ports on which servers listen, and where to count what is something else."""
        self._ports = ports
        self._counts = counts
        self._budget = Budget()
        self._calls: OrderedDict[bytes, tuple[_Call, int]] = OrderedDict()
        self._contradictions = 0
        self._latest: _Call | None = None

    @property
    def contradictions(self) -> int:
        """Segments sent again with other content."""
        open_calls = (call.connection.contradictions for call, sender in self._calls.values() if sender == 0)
        return self._contradictions + sum(open_calls)

    def receive(self, key: bytes, segment: Segment, time: int, packet: int) -> list[tuple[Flow, Sighting]]:
        """Take a segment in and return what is known to have been said by now.

        Args:
            key: source and destination address, source and destination port.
            segment: the rest of it.
            time: when it was captured, in nanoseconds.
            packet: its number.
        """
        known = self._calls.get(key)
        if known is not None:
            usual = self._listen_usual(*known, segment, time, packet)
            if usual is not None:
                return usual
        found: list[tuple[Flow, Sighting]] = []
        if known is not None and known[0].connection.is_followed_by(known[1], segment):
            found = self._end(known[0], time, packet)
            known = None
        if known is None:
            if not segment.data and not segment.flags & SYN:
                return []
            if len(self._calls) >= 2 * CONNECTIONS_LIMIT:
                found += self._end(next(iter(self._calls.values()))[0], time, packet)
            known = self._begin(key)
        self._touch(known[0])
        return found + self._listen(*known, segment, time, packet)

    def close(self, time: int, packet: int) -> list[tuple[Flow, Sighting]]:
        """End the capture: give out what was held back and what was begun."""
        found: list[tuple[Flow, Sighting]] = []
        while self._calls:
            found += self._end(next(iter(self._calls.values()))[0], time, packet)
        return found

    def _listen_usual(
        self, call: _Call, sender: int, segment: Segment, time: int, packet: int
    ) -> list[tuple[Flow, Sighting]] | None:
        """Take in what nearly all segments of a known conversation are; None for any other."""
        flows = None if call.talk is None or call.talk.tentative else call.talk.flows
        if flows is None:
            return None
        said = call.connection.receive_usual(sender, segment, time, packet)
        if said is None:
            return None
        self._touch(call)
        return [(flows[sender], sighting) for sighting in said]

    def _touch(self, call: _Call) -> None:
        """Note that this is the call heard last."""
        if call is not self._latest:
            self._latest = call
            for each in call.keys:
                self._calls.move_to_end(each)

    def _begin(self, key: bytes) -> tuple[_Call, int]:
        call = _Call(key, self._budget)
        source, destination = call.ends
        server = server_by_port(self._ports, source.port, destination.port)
        if server is not None:
            call.talk = Talk(call.ends, Transport.TCP)
            call.talk.decide(server, f"port {call.ends[server].port}")
        elif source.port in self._ports:
            call.talk = Talk(call.ends, Transport.TCP)
        for sender, each in enumerate(call.keys):
            self._calls[each] = call, sender
        return call, 0

    def _listen(
        self, call: _Call, sender: int, segment: Segment, time: int, packet: int
    ) -> list[tuple[Flow, Sighting]]:
        if call.talk is None and segment.data:
            call.talk = _recognise(call, sender, segment)
            if call.talk is None:
                call.connection.close(time, packet)
                call.connection = Connection(self._budget)
                self._counts.not_bcap += 1
                return []
        said = call.connection.receive(sender, segment, time, packet)
        if call.talk is None:
            return []
        call.doubtful += call.talk.tentative and bool(segment.data)
        if segment.flags & (FIN | RST):
            call.talk.close(sender, bool(segment.flags & RST), time)
        if call.talk.flows is None and call.connection.server is not None:
            call.talk.decide(call.connection.server, "the TCP handshake: this end accepted the connection")
        if not all(call.talk.hear(each, sighting) for each, sighting in said):
            self._reject(call)
            return []
        return call.talk.release()

    def _reject(self, call: _Call) -> None:
        """Go back to not knowing what this is."""
        self._counts.not_bcap += call.doubtful
        call.connection.close(0, 0)
        call.talk, call.connection, call.doubtful = None, Connection(self._budget), 0

    def _end(self, call: _Call, time: int, packet: int) -> list[tuple[Flow, Sighting]]:
        for key in set(call.keys):  # one and the same in a forged packet from an end to itself
            del self._calls[key]
        self._contradictions += call.connection.contradictions
        if call.talk is None:
            return []
        said = call.connection.close(time, packet)
        if not all(call.talk.hear(sender, sighting) for sender, sighting in said):
            self._reject(call)
            return []
        call.talk.guess()
        return call.talk.release()


def _recognise(call: _Call, sender: int, segment: Segment) -> Talk | None:
    """Tell by a segment with data whether a connection between unknown ports is b-CAP.

    At the beginning of a stream a frame may begin and be finished later; anywhere else a whole frame has
    to stand at the beginning of a segment.
    """
    if not begins_frame(segment.data):
        return None
    if call.connection.streams[sender].starts_at(segment.seq):
        return Talk(call.ends, Transport.TCP, tentative=True)
    length = int.from_bytes(segment.data[1:5], "little")
    whole = SMALLEST_FRAME <= length <= len(segment.data) and not Frame(segment.data[:length]).problems
    return Talk(call.ends, Transport.TCP) if whole else None
