"""What the server of the simulator talks to: a model of a controller, and a recorder."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from bcapscope.simulator.simulator import Peer, SimulatorOutput
from bcapscope.simulator.simulator_clock import ClockedModel

Address: TypeAlias = tuple[str, int]


class TrafficTap(Protocol):
    """Receives all traffic; addresses are host and port, times ns since 1970."""

    def on_datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Note a UDP datagram."""

    def on_segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Note bytes of a TCP connection."""

    def on_stream_end(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        """Note that one end of a TCP connection sends nothing more, or reset it."""

    def on_connection_end(self, client: Address, server: Address) -> None:
        """Note that a TCP connection is over."""


class ControllerModel(ClockedModel, Protocol):
    """A model that decides what to answer, such as a `Simulator`, whose methods these are."""

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]: ...
    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool: ...
    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]: ...
    def on_disconnect(self, peer: Peer, now: int) -> None: ...
    def reset(self, now: int) -> list[SimulatorOutput]: ...
    def advance(self, now: int) -> list[SimulatorOutput]: ...
