"""The simulator at the other end of a memory link."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from bcapscope.simulator.server import Answerer
from bcapscope.simulator.simulator import Output
from bcapscope.transport.clock import Clock
from bcapscope.transport.memory import MemoryLink


class Controller:
    """Brings packets to a simulator, its answers back, and time to it. One peer a link."""

    def __init__(self, simulator: Answerer) -> None:
        self._simulator = simulator
        self._clock = Clock(asyncio.get_running_loop())
        self._links: dict[str, MemoryLink] = {}
        self._timer: asyncio.TimerHandle | None = None

    def plug(self, name: str, link: MemoryLink) -> None:
        """Let the client behind `link` talk as `name`; whoever did so before is cut off."""
        if name in self._links:
            self._links[name].close()
        self._links[name] = link
        link.receiver = _Socket(self, name)
        if not link.datagrams:
            self._simulator.connect(name, self._clock.now())

    def take(self, name: str, data: bytes) -> None:
        """Take what came from a client."""
        now = self._clock.now()
        take = self._simulator.datagram if self._links[name].datagrams else self._simulator.segment
        self._give(take(name, data, now))

    def hang_up(self, name: str) -> None:
        """Take notice that a connection has ended."""
        self._simulator.disconnect(name, self._clock.now())

    def _give(self, outputs: Iterable[Output]) -> None:
        for peer, data in outputs:
            self._links[str(peer)].send(data)
        if self._timer is not None:
            self._timer.cancel()
        due = self._simulator.due(self._clock.now())
        self._timer = (
            None if due is None else self._clock.wake_at(max(due, self._clock.now() + 1), self._wake)
        )

    def _wake(self) -> None:
        self._give(self._simulator.advance(self._clock.now()))


class _Socket:
    def __init__(self, controller: Controller, name: str) -> None:
        self._controller = controller
        self._name = name

    def received(self, data: bytes) -> None:
        self._controller.take(self._name, data)

    def trouble(self, text: str) -> None:
        raise AssertionError(text)

    def lost(self, reason: str) -> None:
        self._controller.hang_up(self._name)
