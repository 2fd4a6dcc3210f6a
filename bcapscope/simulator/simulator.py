"""The simulated controller with its clients: datagrams and segments in, datagrams and segments out.

It does no I/O and has no clock. Limits of clients: orin_bcap C/src/bCAPServer/bcap_server.c. That server's
UDP service ends when a datagram begins like a frame and is none; here such a datagram is dropped and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.codec.frame import LARGEST_UDP_FRAME, Frame
from bcapscope.protocol.codec.frame_content import EOT, SMALLEST_FRAME, SOH
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.guard import always_passes
from bcapscope.simulator.call_executor import CallExecutor, CallReport
from bcapscope.simulator.machine import InitialState, Machine
from bcapscope.simulator.profile import Profile

MAX_CLIENTS = 20
"""On TCP, and again on UDP."""

STOP_CLIENTS = 4
"""Additional clients of each transport whose first request is a stop. DENSO's C server refuses them; this
limit is our own."""

EVICTABLE_AFTER_NS = 10_000_000_000
"""ns of silence after which a UDP client gives way to a new one when the list is full."""

LARGEST_REQUEST = 64 * 1024
"""Bytes of a request on TCP; our bound, so that a client cannot fill the memory."""

Peer: TypeAlias = Hashable
"""Whatever names a client to the caller: an address, a connection."""


class ResetMarker(bytes):
    """No data, which ends a connection, and that by reset."""


class SimulatorOutput(NamedTuple):
    """Something to send.

    Attributes:
        peer: to whom.
        data: one frame; empty to close the connection.
    """

    peer: Peer
    data: bytes


class _Link(NamedTuple):
    executor: CallExecutor
    splitter: StreamSplitter | None


def _sound_frame(data: bytes) -> Frame | None:
    """Return the one sound frame that a datagram is, or None; of a flood as fast as can be."""
    size = len(data)
    if not SMALLEST_FRAME <= size <= LARGEST_UDP_FRAME or data[0] != SOH or data[-1] != EOT:
        return None
    frame = Frame(data)
    if frame.template_match is not None:  # one that is known is sound
        return frame
    return frame if frame.length == size and not frame.problems else None


def _ignore(peer: Peer, report: CallReport) -> None:
    """Take no notice of a call."""


class Simulator:
    """A controller and all its clients.

    Attributes:
        machine: the controller.
        dropped: datagrams that were no sound frame, or came from a client too many.
        refused: connections closed because of a bad frame or because there were too many.
    """

    def __init__(
        self,
        profile: Profile,
        initial_state: InitialState | None = None,
        now: int = 0,
        report: Callable[[Peer, CallReport], None] = _ignore,
    ) -> None:
        """Switch the controller on.

        Args:
            profile: what kind it is.
            initial_state: its state at the beginning.
            now: ns; all later times count on the same clock.
            report: called with the client and each call that is answered.
        """
        self.machine = Machine(profile, initial_state, now)
        self.dropped = 0
        self.refused = 0
        self._report = report
        self._links: dict[Peer, _Link] = {}
        self._running: dict[Peer, CallExecutor] = {}
        self._stops: dict[Peer, None] = {}  # UDP clients in a kept place, the oldest first
        self._number = 0
        for place in range(self.machine.initial_state.udp_clients):
            self._add_client(("half-open", "udp", place), None, now)
        for place in range(self.machine.initial_state.tcp_clients):
            self._add_client(("half-open", "tcp", place), StreamSplitter(limit=LARGEST_REQUEST), now)

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Take a UDP datagram; return what to send."""
        frame = _sound_frame(data)
        if frame is None:
            self.dropped += 1
            return []
        link = self._links.get(peer) or self._add_udp_client(peer, frame, now)
        if link is None:
            self.dropped += 1
            return []
        return self._on_request(peer, link.executor, frame, now)

    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Take a TCP connection; return False if there are too many, for the caller to close it.

        Args:
            peer: the client.
            now: ns.
            is_stop: its first request is a stop, which is taken beyond the usual limit.
        """
        if self._client_count(udp=False) >= MAX_CLIENTS + STOP_CLIENTS * is_stop:
            self.refused += 1
            return False
        self._add_client(peer, StreamSplitter(limit=LARGEST_REQUEST), now)
        return True

    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Take bytes of a connection; return what to send.

        A bad frame ends the connection without a reply, bytes outside of any frame are skipped.
        """
        link = self._links.get(peer)
        if link is None or link.splitter is None:
            return []
        outputs: list[SimulatorOutput] = []
        for piece in link.splitter.feed(data):
            frame = piece.item
            if not isinstance(frame, Frame):
                continue
            if frame.problems:
                self.refused += 1
                self.on_disconnect(peer, now)
                outputs.append(SimulatorOutput(peer, b""))
                break
            outputs += self._on_request(peer, link.executor, frame, now)
        return outputs

    def on_disconnect(self, peer: Peer, now: int) -> None:
        """Let go of a client that is gone."""
        link = self._links.pop(peer, None)
        self._running.pop(peer, None)
        self._stops.pop(peer, None)
        if link is not None:
            link.executor.close(now)

    def reset(self, now: int) -> list[SimulatorOutput]:
        """Press the pendant's Reset button: every client is forgotten (DENSO Wave 2009)."""
        peers = [peer for peer, link in self._links.items() if link.splitter is not None]
        for peer in list(self._links):
            self.on_disconnect(peer, now)
        return [SimulatorOutput(peer, b"") for peer in peers]

    def advance(self, now: int) -> list[SimulatorOutput]:
        """Let time pass; return what to send."""
        self.machine.advance(now)
        return self._poll(now) if self._running else []

    def due(self, now: int) -> int | None:
        """Return when `advance` is to be called next at the latest; None if nothing is under way."""
        due = self.machine.due()
        if not self._running:
            return due
        times = [due, *(conversation.due(now) for conversation in self._running.values())]
        return min((time for time in times if time is not None), default=None)

    @property
    def runs_in_real_time(self) -> bool:
        """Whether its time goes on while it gets no processor, as that of clients does that set the pace."""
        mode = self.machine.slave.mode
        return mode is not None and mode.overwrites_waiting

    @property
    def has_running_calls(self) -> bool:
        """Whether a call waits for time to pass."""
        return bool(self._running)

    @property
    def client_count(self) -> int:
        """Clients that are remembered."""
        return len(self._links)

    def _on_request(
        self, peer: Peer, conversation: CallExecutor, frame: Frame, now: int
    ) -> list[SimulatorOutput]:
        """Hand on a request; what others wait for may have come true by it."""
        outputs = []
        for each in conversation.on_request(frame, now):
            outputs.append(SimulatorOutput(peer, each))  # a list made at once would take a call of its own
        if conversation.running:
            self._running[peer] = conversation
        return outputs + self._poll(now) if self._running else outputs

    def _poll(self, now: int) -> list[SimulatorOutput]:
        outputs: list[SimulatorOutput] = []
        for peer, conversation in list(self._running.items()):
            outputs += [SimulatorOutput(peer, each) for each in conversation.poll(now)]
            if not conversation.running:
                del self._running[peer]
        return outputs

    def _client_count(self, udp: bool) -> int:
        return sum((link.splitter is None) is udp for link in self._links.values())

    def _add_udp_client(self, peer: Peer, frame: Frame, now: int) -> _Link | None:
        if self._client_count(udp=True) - len(self._stops) >= MAX_CLIENTS and not self._evict_silent_client(
            now
        ):
            if not always_passes(frame.code, frame.variants):
                return None
            if len(self._stops) >= STOP_CLIENTS:
                self.on_disconnect(next(iter(self._stops)), now)
            self._stops[peer] = None
        return self._add_client(peer, None, now)

    def _evict_silent_client(self, now: int) -> bool:
        """Forget the UDP client that has been silent for longest, if that is long enough."""
        silent = [(link.executor.last_heard, peer) for peer, link in self._links.items() if not link.splitter]
        heard, peer = min(silent, key=lambda each: each[0])
        if now - heard < EVICTABLE_AFTER_NS:
            return False
        self.on_disconnect(peer, now)
        return True

    def _add_client(self, peer: Peer, splitter: StreamSplitter | None, now: int) -> _Link:
        self._number += 1
        conversation = CallExecutor(self.machine, self._number, splitter is None, partial(self._report, peer))
        conversation.last_heard = now
        link = self._links[peer] = _Link(conversation, splitter)
        return link
