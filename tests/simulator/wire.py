"""Playing a playbook over real sockets: the time is still the playbook's, so each reply keeps its time.

The time goes on only when all that was sent has arrived. So a slow machine changes no reply.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

from bcapscope.protocol.codec.frame import Frame
from bcapscope.simulator.simulator import Peer, SimulatorOutput
from bcapscope.simulator.simulator_server import SimulatorServer
from tests.simulator.performance import Performance
from tests.simulator.playbook import Playbook
from tests.simulator.simulation import Simulation

DEADLINE = 20.0
"""Seconds that something may be on its way."""

LENGTH = slice(1, 5)
"""Place of a frame's length."""


class Wire:
    """What a server answers with: the controller of one playbook after the other, at the playbook's time.

    Attributes:
        simulation: controller and time.
        heard: bytes that came from clients.
        sent: bytes that were answered.
        peers: connections over TCP.
    """

    runs_in_real_time = False
    has_running_calls = False

    def __init__(self) -> None:
        self.simulation = Simulation()
        self.heard = self.sent = 0
        self.peers: set[Peer] = set()
        self._pending: list[SimulatorOutput] = []

    def send(self, outputs: list[SimulatorOutput]) -> None:
        """Have the server send something with its next step."""
        self._pending += outputs

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Take a datagram."""
        self.heard += len(data)
        return self._counted(self.simulation.answerer.on_datagram(peer, data, self.simulation.now))

    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Take a connection."""
        self.peers.add(peer)
        return self.simulation.answerer.on_connect(peer, self.simulation.now, is_stop)

    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Take bytes of a connection."""
        self.heard += len(data)
        return self._counted(self.simulation.answerer.on_segment(peer, data, self.simulation.now))

    def on_disconnect(self, peer: Peer, now: int) -> None:
        """Part from a connection."""
        self.peers.discard(peer)
        self.simulation.answerer.on_disconnect(peer, self.simulation.now)

    def reset(self, now: int) -> list[SimulatorOutput]:
        """Forget all clients."""
        return self._counted(self.simulation.answerer.reset(self.simulation.now))

    def advance(self, now: int) -> list[SimulatorOutput]:
        """Return what is to be sent."""
        outputs, self._pending = self._pending, []
        return self._counted(outputs)

    def due(self, now: int) -> int | None:
        """Return `now` while something is to be sent."""
        return now if self._pending else None

    def _counted(self, outputs: list[SimulatorOutput]) -> list[SimulatorOutput]:
        self.sent += sum(len(data) for _, data in outputs)
        return outputs


class WirePerformance(Performance):
    """A playbook whose clients have real sockets.

    Attributes:
        wire: answers in the server.
    """

    def __init__(
        self, playbook: Playbook, profile: str, server: SimulatorServer, wire: Wire, port: int
    ) -> None:
        """Connect the clients to the port of `server`, in which `wire` answers, or of a proxy before it."""
        self.wire = wire
        self._server, self._port = server, port
        self._sockets: dict[str, socket.socket] = {}
        self._rests: dict[str, bytes] = {}
        self._sent, self._received = wire.heard, wire.sent
        super().__init__(playbook, profile)
        wire.simulation = self.simulation

    def connect(self) -> None:
        """Open a socket for each client."""
        for name, speaker in self.speakers.items():
            kind = socket.SOCK_STREAM if speaker.tcp else socket.SOCK_DGRAM
            made = socket.socket(socket.AF_INET, kind)
            made.connect(("127.0.0.1", self._port))
            made.setblocking(False)
            self._sockets[name], self._rests[name] = made, b""

    def close(self) -> None:
        """Close the sockets and wait until the server has noticed."""
        for each in self._sockets.values():
            each.close()
        self._step_until(lambda: not self.wire.peers)

    def transmit(self, name: str, raw: bytes) -> list[SimulatorOutput]:
        """Send a request over the client's socket."""
        self._sent += len(raw)
        assert self._sockets[name].send(raw) == len(raw)
        self.deliver([])
        return []

    def deliver(self, outputs: list[SimulatorOutput]) -> None:
        """Let the server send, and wait until nothing is on its way in either direction."""
        self.wire.send(outputs)
        self._step_until(self._has_all_arrived)

    def _has_all_arrived(self) -> bool:
        for name in self._sockets:
            self._read(name)
        idle = self.wire.due(0) is None and self.wire.heard == self._sent
        return idle and self.wire.sent == self._received

    def _read(self, name: str) -> None:
        speaker, sock = self.speakers[name], self._sockets[name]
        try:
            data = sock.recv(65536)
        except BlockingIOError:
            return
        self._received += len(data)
        data = self._rests[name] + data
        while len(data) >= LENGTH.stop and len(data) >= (length := int.from_bytes(data[LENGTH], "little")):
            speaker.inbox.append(Frame(data[:length]))
            data = data[length:]
        self._rests[name] = data

    def _step_until(self, done: Callable[[], bool]) -> None:
        until = time.monotonic() + DEADLINE
        while not done():
            assert time.monotonic() < until, "a frame got lost on its way"
            self._server.step(0.001)
