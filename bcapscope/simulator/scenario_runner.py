"""Playing a scenario: a simulator, with the scenario's faults between the simulator and its clients.

A `ScenarioRunner` does no I/O and has no clock. Faults affect a request after the socket has received it, and
a reply before the socket sends it. A capture at the socket therefore shows the same as a capture at the
controller's end of the cable.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from typing import NamedTuple

from bcapscope.faults.attempt_counter import AttemptCounter
from bcapscope.faults.fault import CloseMode
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.fault_matcher import FaultMatcher
from bcapscope.faults.wire_message import CloseConnection, SendBytes, WireMessage
from bcapscope.faults.wire_message import FaultOutput as Verdict
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.simulator.scenario import FaultsAndEvents, Scenario
from bcapscope.simulator.scenario_event import AnyEvent, ScenarioEvent
from bcapscope.simulator.simulator import LARGEST_REQUEST, Peer, ResetMarker, Simulator, SimulatorOutput
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Transport,
)

MAX_LINES = 1024
"""Maximum number of clients. A further client replaces the UDP client that has been silent longest."""

_HERE = Endpoint("simulator", 0)


class _ClientLine(NamedTuple):
    """The connection to one client: `up` carries requests, and `down` carries replies."""

    peer: Peer
    up: Flow
    down: Flow
    splitter: StreamSplitter | None


class ScenarioRunner:
    """A simulator with the faults and events of a scenario; `shaper` applies the faults to messages."""

    def __init__(
        self,
        scenario: Scenario,
        simulator: Simulator,
        now: int,
        *,
        seed: int | None = None,
        on_news: Callable[[Message], None] = lambda news: None,
    ) -> None:
        """`simulator` must have the scenario's profile and start state. `seed` replaces the scenario's seed.

        `on_news` gets the name of each event and fault that happens.
        """
        self.simulator = simulator
        self._scenario = scenario
        self._seed = scenario.seed if seed is None else seed
        self._on_news = on_news
        epoch = simulator.machine.initial_state.epoch
        self.shaper = FaultInjector(seed=self._seed, now=now, epoch=epoch)
        self._epoch = epoch
        self._lines: dict[Peer, _ClientLine] = {}
        self._peers: dict[Conversation, Peer] = {}
        self._timed: list[tuple[int, int, AnyEvent]] = []
        self._triggered: list[tuple[AnyEvent, FaultMatcher]] = []
        self._templates = FrameTemplates()
        self._recent_requests, self._attempts = RecentRequests(), AttemptCounter()
        self._messages = self._counted = 0
        self._was_in_slave_mode = False
        scenario.write_variables(simulator.machine.memory)
        self._schedule(scenario.faults, now)

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        outputs = self.advance(now)
        return outputs + self._on_client_message(self._line_of(peer, Transport.UDP), data, now)

    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        self._line_of(peer, Transport.TCP)
        taken = self.simulator.on_connect(peer, now, is_stop)
        if not taken:
            self._remove_client(peer)
        return taken

    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        outputs = self.advance(now)
        line = self._lines.get(peer)
        if line is None or line.splitter is None:
            return outputs
        for piece in line.splitter.feed(data):
            if self._lines.get(peer) is line:
                outputs += self._on_client_message(line, piece.item.raw, now)
        return outputs

    def on_disconnect(self, peer: Peer, now: int) -> None:
        """Remove a client, unless a fault hides the disconnection from the controller."""
        line = self._lines.get(peer)
        if line is None or self.shaper.passes_close(line.up.conversation):
            self.simulator.on_disconnect(peer, now)
        self._remove_client(peer)

    def reset(self, now: int) -> list[SimulatorOutput]:
        return self._send_to_clients(self.simulator.reset(now), now)

    def due(self, now: int) -> int | None:
        times = (self.simulator.due(now), self.shaper.due(), self._timed[0][0] if self._timed else None)
        return min((time for time in times if time is not None), default=None)

    @property
    def runs_in_real_time(self) -> bool:
        return self.simulator.runs_in_real_time

    @property
    def has_running_calls(self) -> bool:
        return self.simulator.has_running_calls

    def _schedule(self, faults_and_events: FaultsAndEvents, now: int) -> None:
        for each in faults_and_events:
            if not isinstance(each, ScenarioEvent):
                self.shaper.add(each, now)
            elif each.is_timed:
                self._counted += 1
                heapq.heappush(self._timed, (now + each.after, self._counted, each))
            else:
                self._counted += 1
                name = each.name or f"{each.action} {self._counted}"
                self._triggered.append((each, FaultMatcher(each, name, self._seed, now)))

    def _apply_event(self, event: AnyEvent, now: int) -> list[SimulatorOutput]:
        self._on_news(foreign_text(event.name or event.action))
        return self._send_to_clients(event.apply(self.simulator, now) or (), now)

    def advance(self, now: int) -> list[SimulatorOutput]:
        """Run all events and messages that are due by `now`, in order of time."""
        outputs: list[SimulatorOutput] = []
        while self._timed and self._timed[0][0] <= now:
            when, _, event = heapq.heappop(self._timed)
            outputs += self._send_to_clients(self.simulator.advance(when), when)
            outputs += self._apply_event(event, when)
        outputs += self._carry_out(self.shaper.advance(now), now)
        outputs += self._send_to_clients(self.simulator.advance(now), now)
        self._check_slave_mode(now)
        return outputs

    def _check_slave_mode(self, now: int) -> None:
        if not self._was_in_slave_mode and self.simulator.machine.slave.mode is not None:
            self._was_in_slave_mode = True
            self._schedule(self._scenario.in_slave_mode, now)

    def _on_client_message(self, line: _ClientLine, data: bytes, now: int) -> list[SimulatorOutput]:
        outputs = self._trigger_events(line, data, now) if self._triggered else []
        return outputs + self._shape(line.up, data, now)

    def _shape(self, flow: Flow, data: bytes, now: int) -> list[SimulatorOutput]:
        taken = self.shaper.process_message(flow, data, now)
        for note in taken.fault_notes:
            self._on_news(note)
        return self._carry_out(taken.outputs, now)

    def _trigger_events(self, line: _ClientLine, data: bytes, now: int) -> list[SimulatorOutput]:
        self._messages += 1
        message = WireMessage(
            self._messages, line.up, data, now, now + self._epoch, templates=self._templates
        )
        message.annotate_with_attempts(self._recent_requests, self._attempts)
        outputs: list[SimulatorOutput] = []
        for event, matcher in self._triggered:
            if matcher.matches(message) and matcher.draw():
                matcher.count_hit()
                outputs += self._apply_event(event, now)
        return outputs

    def _carry_out(self, verdicts: Iterable[Verdict], now: int) -> list[SimulatorOutput]:
        outputs: list[SimulatorOutput] = []
        for verdict in verdicts:
            if isinstance(verdict, CloseConnection):
                outputs += self._close_connection(verdict, now)
            elif verdict.flow.direction is Direction.REQUEST:
                outputs += self._send_to_controller(verdict, now)
            else:
                peer = self._peers.get(verdict.flow.conversation)
                outputs += [] if peer is None else [SimulatorOutput(peer, verdict.data)]
        return outputs

    def _send_to_controller(self, send: SendBytes, now: int) -> list[SimulatorOutput]:
        peer = self._peers.get(send.flow.conversation)
        if peer is None:
            return []
        udp = send.flow.conversation.transport is Transport.UDP
        take = self.simulator.on_datagram if udp else self.simulator.on_segment
        outputs = self._send_to_clients(take(peer, send.data, now), now)
        self._check_slave_mode(now)
        return outputs

    def _send_to_clients(self, outputs: Iterable[SimulatorOutput], now: int) -> list[SimulatorOutput]:
        passed: list[SimulatorOutput] = []
        for output in outputs:
            line = self._lines.get(output.peer)
            if line is None or not output.data:
                self._remove_client(output.peer)
                passed.append(output)
            else:
                passed += self._shape(line.down, output.data, now)
        return passed

    def _close_connection(self, closing: CloseConnection, now: int) -> list[SimulatorOutput]:
        peer = self._peers.get(closing.conversation)
        if peer is None:
            return []
        self.on_disconnect(peer, now)
        return [SimulatorOutput(peer, ResetMarker() if closing.how is CloseMode.RESET else b"")]

    def _line_of(self, peer: Peer, transport: Transport) -> _ClientLine:
        line = self._lines.pop(peer, None) or self._new_line(peer, transport)
        self._lines[peer] = line
        return line

    def _new_line(self, peer: Peer, transport: Transport) -> _ClientLine:
        if len(self._lines) >= MAX_LINES:
            datagram_lines = (each.peer for each in self._lines.values() if each.splitter is None)
            self._remove_client(next(datagram_lines, None))
        conversation = Conversation(_endpoint(peer), _HERE, transport, SERVER_PARTICIPANT)
        self._peers[conversation] = peer
        splitter = StreamSplitter(limit=LARGEST_REQUEST) if transport is Transport.TCP else None
        up, down = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
        return _ClientLine(peer, up, down, splitter)

    def _remove_client(self, peer: Peer) -> None:
        line = self._lines.pop(peer, None)
        if line is not None:
            del self._peers[line.up.conversation]
            self.shaper.close_conversation(line.up.conversation)


def _endpoint(peer: Peer) -> Endpoint:
    match peer:
        case (_, (str(host), int(port), *_)):
            return Endpoint(host, port)
    return Endpoint(str(peer), 0)
