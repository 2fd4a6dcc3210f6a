"""The simulator at the other end of a memory link."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from bcapscope.capture.socket_recording import Address, SocketRecording
from bcapscope.messages import Message
from bcapscope.simulator.simulator import SimulatorOutput
from bcapscope.simulator.simulator_server import ControllerModel
from bcapscope.transport.loop_clock import LoopClock
from tests.memory_link import MemoryLink
from tests.samples.calls import CLIENT, SERVER, START

_SERVER: Address = (SERVER.ip, SERVER.port)


class Controller:
    """Brings packets to a simulator, its answers back, and time to it. One peer a link.

    What passes can be recorded as a socket of the simulator would see it, each client with a port of its own.
    """

    def __init__(self, simulator: ControllerModel, recording: SocketRecording | None = None) -> None:
        self._simulator = simulator
        self._recording = recording
        self._clock = LoopClock(asyncio.get_running_loop())
        self._links: dict[str, MemoryLink] = {}
        self._addresses: dict[str, Address] = {}
        self._timer: asyncio.TimerHandle | None = None

    def plug(self, name: str, link: MemoryLink) -> None:
        """Let the client behind `link` talk as `name`; whoever did so before is cut off."""
        if name in self._links:
            self._links[name].close()
        self._addresses.setdefault(name, (CLIENT.ip, CLIENT.port + len(self._addresses)))
        self._links[name] = link
        link.receiver = _Socket(self, name)
        if not link.datagrams and not self._simulator.on_connect(name, self._clock.now()):
            self._links.pop(name).close()
        self._look()

    def take(self, name: str, data: bytes) -> None:
        """Take what came from a client."""
        now, link = self._clock.now(), self._links[name]
        self._record(self._addresses[name], _SERVER, link, data)
        take = self._simulator.on_datagram if link.datagrams else self._simulator.on_segment
        self._give(take(name, data, now))

    def hang_up(self, name: str) -> None:
        """Take notice that a connection has ended."""
        self._simulator.on_disconnect(name, self._clock.now())

    def _give(self, outputs: Iterable[SimulatorOutput]) -> None:
        for peer, data in outputs:
            name = str(peer)
            link = self._links.get(name)
            if link is not None and data:
                self._record(_SERVER, self._addresses[name], link, data)
                link.send(data)
            elif link is not None:
                self._links.pop(name).close()
        self._look()

    def _look(self) -> None:
        """Let the simulator be called when something is due next."""
        if self._timer is not None:
            self._timer.cancel()
        due = self._simulator.due(self._clock.now())
        self._timer = (
            None if due is None else self._clock.call_at(max(due, self._clock.now() + 1), self._wake)
        )

    def _record(self, source: Address, target: Address, link: MemoryLink, data: bytes) -> None:
        if self._recording is not None:
            write = self._recording.write_datagram if link.datagrams else self._recording.write_segment
            write(source, target, data, START + self._clock.now())

    def _wake(self) -> None:
        self._give(self._simulator.advance(self._clock.now()))


class _Socket:
    def __init__(self, controller: Controller, name: str) -> None:
        self._controller = controller
        self._name = name

    def on_data(self, data: bytes) -> None:
        self._controller.take(self._name, data)

    def on_send_error(self, reason: Message) -> None:
        raise AssertionError(reason)

    def on_link_lost(self, reason: Message) -> None:
        self._controller.hang_up(self._name)
