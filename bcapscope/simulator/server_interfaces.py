"""Interfaces that the simulator's server uses: a model of a controller, and a receiver of traffic."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from bcapscope.simulator.simulator import Peer, SimulatorOutput
from bcapscope.simulator.simulator_clock import ClockedModel

Address: TypeAlias = tuple[str, int]


class TrafficTap(Protocol):
    """Receives all traffic of the server; addresses are host and port, times are ns since 1970."""

    def on_datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Note a UDP datagram."""

    def on_segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Note bytes of a TCP connection."""

    def on_stream_end(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        """Note that one end of a TCP connection closed or reset it."""

    def on_connection_end(self, client: Address, server: Address) -> None:
        """Note that a TCP connection is over."""


class ControllerModel(ClockedModel, Protocol):
    """A model that decides the replies, such as a `Simulator`; each method is as in that class."""

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]: ...
    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool: ...
    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]: ...
    def on_disconnect(self, peer: Peer, now: int) -> None: ...
    def reset(self, now: int) -> list[SimulatorOutput]: ...
    def advance(self, now: int) -> list[SimulatorOutput]: ...
