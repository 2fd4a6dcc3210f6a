"""The simulated controller with its clients: datagrams and segments in, datagrams and segments out.

The model does no I/O and has no clock.
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
from bcapscope.simulator.hosted_client import HostedClient
from bcapscope.simulator.machine import InitialState, Machine
from bcapscope.simulator.profile import Profile

MAX_CLIENTS = 20
"""Maximum number of clients per transport, TCP or UDP."""

STOP_CLIENTS = 4
"""Number of clients per transport that may connect beyond `MAX_CLIENTS` to send a stop. DENSO's C server
refuses such clients.
"""

EVICTABLE_AFTER_NS = 10_000_000_000
"""If the maximum number of UDP clients is reached, a new client can replace the client that was silent
longest, but only if that client sent no request for this time in ns.
"""

LARGEST_REQUEST = 64 * 1024
"""Largest request on TCP in bytes; the limit is bcapscope's own, so that a client cannot fill the memory."""

Peer: TypeAlias = Hashable
"""Any key that identifies a client, such as an address."""


class ResetMarker(bytes):
    """A `ResetMarker` as `SimulatorOutput.data` makes the server reset the TCP connection."""


class SimulatorOutput(NamedTuple):
    """One frame to send to a client. If the data is empty, the server closes the connection."""

    peer: Peer
    data: bytes


ClientFactory: TypeAlias = Callable[[int, bool, Callable[[CallReport], None]], HostedClient]
"""Arguments: the client's number, whether it uses UDP, and a function that gets each answered call."""


class _Link(NamedTuple):
    client: HostedClient
    splitter: StreamSplitter | None


def _sound_frame(data: bytes, templates: FrameTemplates) -> Frame | None:
    """Return the frame if a datagram is exactly one valid frame. This check must stay fast during a flood."""
    size = len(data)
    if not SMALLEST_FRAME <= size <= LARGEST_UDP_FRAME or data[0] != SOH or data[-1] != EOT:
        return None
    frame = Frame(data, None, templates)
    if frame.template_match is not None:  # a frame that matches a template is valid
        return frame
    return frame if frame.length == size and not frame.problems else None


class ClientHost:
    """Finds the client of each request, and limits the number of clients.

    Attributes:
        dropped: Number of datagrams that were not a valid frame, or came from a client beyond the limit.
        closes_on_bad_frame: Whether a bad frame ends the connection; if False, the frame is skipped.
    """

    evictable_after = EVICTABLE_AFTER_NS
    closes_on_bad_frame = True

    def __init__(self, new_client: ClientFactory, report: Callable[[Peer, CallReport], None]) -> None:
        """Start without clients. After each answered call, `report` gets the client and the call."""
        self.dropped = 0
        self._new_client = new_client
        self._report = report
        self._templates = FrameTemplates()
        self._links: dict[Peer, _Link] = {}
        self._running: dict[Peer, HostedClient] = {}
        # UDP clients that were accepted only because their first request was a stop, oldest first
        self._stops: dict[Peer, None] = {}
        self._number = 0

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        frame = _sound_frame(data, self._templates)
        if frame is None:
            self.dropped += 1
            return []
        link = self._links.get(peer) or self._add_udp_client(peer, frame, now)
        if link is None:
            self.dropped += 1
            return []
        return self._on_request(peer, link.client, frame, now)

    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Accept a TCP connection, or return False if there are too many clients. The limit is `MAX_CLIENTS`.
        If the first request is a stop (`is_stop`), the limit is higher by `STOP_CLIENTS`.
        """
        if self._client_count(udp=False) >= MAX_CLIENTS + STOP_CLIENTS * is_stop:
            return False
        self._add_client(peer, False, now)
        return True

    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        link = self._links.get(peer)
        if link is None or link.splitter is None:
            return []
        outputs: list[SimulatorOutput] = []
        for piece in link.splitter.feed(data):
            frame = piece.item
            if not isinstance(frame, Frame):
                continue
            if not frame.problems:
                outputs += self._on_request(peer, link.client, frame, now)
            elif self.closes_on_bad_frame:
                self.on_disconnect(peer, now)
                outputs.append(SimulatorOutput(peer, b""))
                break
        return outputs

    def on_disconnect(self, peer: Peer, now: int) -> None:
        link = self._links.pop(peer, None)
        self._running.pop(peer, None)
        self._stops.pop(peer, None)
        if link is not None:
            link.client.close()

    def reset(self, now: int) -> list[SimulatorOutput]:
        """Forget every client, as after the pendant's Reset button (DENSO Wave 2009); close connections."""
        peers = [peer for peer, link in self._links.items() if link.splitter is not None]
        for peer in list(self._links):
            self.on_disconnect(peer, now)
        return [SimulatorOutput(peer, b"") for peer in peers]

    def advance(self, now: int) -> list[SimulatorOutput]:
        return self._poll(now) if self._running else []

    def due(self, now: int) -> int | None:
        """Return the time in ns by which to call `advance` next; None if nothing is in progress."""
        return self._earliest_due(None, now)

    def _earliest_due(self, due: int | None, now: int) -> int | None:
        for client in self._running.values():
            time = client.due(now)
            if time is not None and (due is None or time < due):
                due = time
        return due

    @property
    def client_count(self) -> int:
        return len(self._links)

    def _on_request(self, peer: Peer, client: HostedClient, frame: Frame, now: int) -> list[SimulatorOutput]:
        """Process a request, then poll the running calls: the request may have completed them."""
        client.last_heard = now
        outputs = []
        for each in client.on_request(frame, now):
            # a comprehension costs a function call, so a loop is faster
            outputs.append(SimulatorOutput(peer, each))
        if client.running:
            self._running[peer] = client
        return outputs + self._poll(now) if self._running else outputs

    def _poll(self, now: int) -> list[SimulatorOutput]:
        outputs: list[SimulatorOutput] = []
        for peer, client in list(self._running.items()):
            outputs += [SimulatorOutput(peer, each) for each in client.poll(now)]
            if not client.running:
                del self._running[peer]
        return outputs

    def _client_count(self, udp: bool) -> int:
        return sum((link.splitter is None) is udp for link in self._links.values())

    def _add_udp_client(self, peer: Peer, frame: Frame, now: int) -> _Link | None:
        is_full = self._client_count(udp=True) - len(self._stops) >= MAX_CLIENTS
        if is_full and not self._evict_silent_client(now):
            if not always_passes(frame.code, frame.variants):
                return None
            if len(self._stops) >= STOP_CLIENTS:
                self.on_disconnect(next(iter(self._stops)), now)
            self._stops[peer] = None
        return self._add_client(peer, True, now)

    def _evict_silent_client(self, now: int) -> bool:
        """Remove the UDP client that was silent longest; return False if the silence was too short."""
        silent = [(link.client.last_heard, peer) for peer, link in self._links.items() if not link.splitter]
        heard, peer = min(silent, key=lambda each: each[0])
        if now - heard < self.evictable_after:
            return False
        self.on_disconnect(peer, now)
        return True

    def _add_client(self, peer: Peer, udp: bool, now: int) -> _Link:
        self._number += 1
        client = self._new_client(self._number, udp, partial(self._report, peer))
        client.last_heard = now
        splitter = None if udp else StreamSplitter(limit=LARGEST_REQUEST, templates=self._templates)
        link = self._links[peer] = _Link(client, splitter)
        return link


class Simulator(ClientHost):
    """A controller and all its clients; `machine` is the state of the controller."""

    def __init__(
        self,
        profile: Profile,
        initial_state: InitialState | None = None,
        now: int = 0,
        report: Callable[[Peer, CallReport], None] = lambda peer, report: None,
    ) -> None:
        """Switch the controller on at the time `now`, in ns of a clock that the caller chooses."""
        self.machine = Machine(profile, initial_state, now)
        super().__init__(partial(CallExecutor, self.machine), report)
        for place in range(self.machine.initial_state.udp_clients):
            self._add_client(("half-open", "udp", place), True, now)
        for place in range(self.machine.initial_state.tcp_clients):
            self._add_client(("half-open", "tcp", place), False, now)

    def advance(self, now: int) -> list[SimulatorOutput]:
        self.machine.advance(now)
        return self._poll(now) if self._running else []

    def due(self, now: int) -> int | None:
        return self._earliest_due(self.machine.due(), now)

    @property
    def runs_in_real_time(self) -> bool:
        """True in a slave mode where the client sets the pace. The simulated clock then never stops. In all
        other states, the clock may stop while other programs use the processor.
        """
        mode = self.machine.slave.mode
        return mode is not None and mode.overwrites_waiting

    @property
    def has_running_calls(self) -> bool:
        return bool(self._running)
