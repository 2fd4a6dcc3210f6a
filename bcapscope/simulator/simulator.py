"""The simulated controller with its clients: datagrams and segments in, datagrams and segments out.

The model does no I/O and has no clock. The limits on clients are those of orin_bcap
C/src/bCAPServer/bcap_server.c. That server's UDP service ends when a datagram begins like a frame but is
none. The simulator drops and counts such a datagram.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.codec.frame import LARGEST_UDP_FRAME, Frame
from bcapscope.protocol.codec.frame_content import EOT, SMALLEST_FRAME, SOH
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.guard import always_passes
from bcapscope.simulator.call_executor import CallExecutor, CallReport
from bcapscope.simulator.machine import InitialState, Machine
from bcapscope.simulator.profile import Profile

MAX_CLIENTS = 20
"""Maximum number of clients on TCP, and of clients on UDP."""

STOP_CLIENTS = 4
"""Number of additional clients per transport whose first request is a stop. DENSO's C server refuses such
clients; the additional places are bcapscope's own."""

EVICTABLE_AFTER_NS = 10_000_000_000
"""Silence of a UDP client, in ns, after which a new client replaces it if all places are taken."""

LARGEST_REQUEST = 64 * 1024
"""Largest request on TCP in bytes; the limit is bcapscope's own, so that a client cannot fill the memory."""

Peer: TypeAlias = Hashable
"""Key by which the caller identifies a client, such as an address or a connection."""


class ResetMarker(bytes):
    """Empty data that tells the server to reset a connection."""


class SimulatorOutput(NamedTuple):
    """One frame to send to a client; empty data closes the connection."""

    peer: Peer
    data: bytes


class _Link(NamedTuple):
    executor: CallExecutor
    splitter: StreamSplitter | None


def _sound_frame(data: bytes, templates: FrameTemplates) -> Frame | None:
    """Return the frame if a datagram is exactly one valid frame, else None; fast enough for floods."""
    size = len(data)
    if not SMALLEST_FRAME <= size <= LARGEST_UDP_FRAME or data[0] != SOH or data[-1] != EOT:
        return None
    frame = Frame(data, None, templates)
    if frame.template_match is not None:  # a frame that matches a template is valid
        return frame
    return frame if frame.length == size and not frame.problems else None


class Simulator:
    """A controller and all its clients.

    Attributes:
        machine: The state of the controller.
        dropped: Number of datagrams that were no valid frame, or came from a client beyond the limit.
        refused: Number of connections that were closed because of a bad frame or too many clients.
    """

    def __init__(
        self,
        profile: Profile,
        initial_state: InitialState | None = None,
        now: int = 0,
        report: Callable[[Peer, CallReport], None] = lambda peer, report: None,
    ) -> None:
        """Switch the controller on at `now`, in ns; all later times use the same clock.

        The simulator calls `report` with the client and the call for each answered call.
        """
        self.machine = Machine(profile, initial_state, now)
        self.dropped = 0
        self.refused = 0
        self._report = report
        self._templates = FrameTemplates()
        self._links: dict[Peer, _Link] = {}
        self._running: dict[Peer, CallExecutor] = {}
        self._stops: dict[Peer, None] = {}  # UDP clients in the additional places for stops, oldest first
        self._number = 0
        for place in range(self.machine.initial_state.udp_clients):
            self._add_client(("half-open", "udp", place), None, now)
        for place in range(self.machine.initial_state.tcp_clients):
            self._add_client(("half-open", "tcp", place), self._new_splitter(), now)

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        frame = _sound_frame(data, self._templates)
        if frame is None:
            self.dropped += 1
            return []
        link = self._links.get(peer) or self._add_udp_client(peer, frame, now)
        if link is None:
            self.dropped += 1
            return []
        return self._on_request(peer, link.executor, frame, now)

    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Accept a TCP connection; return False if all places are taken, so that the caller closes it.

        A client whose first request is a stop (`is_stop`) is accepted beyond the usual limit.
        """
        if self._client_count(udp=False) >= MAX_CLIENTS + STOP_CLIENTS * is_stop:
            self.refused += 1
            return False
        self._add_client(peer, self._new_splitter(), now)
        return True

    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Process bytes of a connection; return the data to send.

        A bad frame ends the connection without a reply. Bytes outside any frame are skipped.
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
        """Remove a client that is gone."""
        link = self._links.pop(peer, None)
        self._running.pop(peer, None)
        self._stops.pop(peer, None)
        if link is not None:
            link.executor.close()

    def reset(self, now: int) -> list[SimulatorOutput]:
        """Press the pendant's Reset button: the controller forgets every client (DENSO Wave 2009)."""
        peers = [peer for peer, link in self._links.items() if link.splitter is not None]
        for peer in list(self._links):
            self.on_disconnect(peer, now)
        return [SimulatorOutput(peer, b"") for peer in peers]

    def advance(self, now: int) -> list[SimulatorOutput]:
        self.machine.advance(now)
        return self._poll(now) if self._running else []

    def due(self, now: int) -> int | None:
        """Return the latest time in ns for the next `advance`; None if nothing is in progress."""
        due = self.machine.due()
        if not self._running:
            return due
        times = [due, *(conversation.due(now) for conversation in self._running.values())]
        return min((time for time in times if time is not None), default=None)

    @property
    def runs_in_real_time(self) -> bool:
        """Whether the model's time continues without processor time, because a client sets the pace."""
        mode = self.machine.slave.mode
        return mode is not None and mode.overwrites_waiting

    @property
    def has_running_calls(self) -> bool:
        """Whether a call is running that ends at a later time."""
        return bool(self._running)

    @property
    def client_count(self) -> int:
        """Number of clients that the controller remembers."""
        return len(self._links)

    def _on_request(
        self, peer: Peer, conversation: CallExecutor, frame: Frame, now: int
    ) -> list[SimulatorOutput]:
        """Process a request, then poll the running calls, because the request may have completed them."""
        outputs = []
        for each in conversation.on_request(frame, now):
            outputs.append(SimulatorOutput(peer, each))  # faster than a comprehension, which costs a call
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
        """Forget the UDP client that was silent longest; return False if no client was silent long enough."""
        silent = [(link.executor.last_heard, peer) for peer, link in self._links.items() if not link.splitter]
        heard, peer = min(silent, key=lambda each: each[0])
        if now - heard < EVICTABLE_AFTER_NS:
            return False
        self.on_disconnect(peer, now)
        return True

    def _new_splitter(self) -> StreamSplitter:
        return StreamSplitter(limit=LARGEST_REQUEST, templates=self._templates)

    def _add_client(self, peer: Peer, splitter: StreamSplitter | None, now: int) -> _Link:
        self._number += 1
        conversation = CallExecutor(self.machine, self._number, splitter is None, partial(self._report, peer))
        conversation.last_heard = now
        link = self._links[peer] = _Link(conversation, splitter)
        return link
