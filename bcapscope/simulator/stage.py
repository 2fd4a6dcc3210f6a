"""Where a scenario is played: a simulator, and between it and its clients the faults of the scenario.

Like the simulator it does no I/O and has no clock, and whatever serves a simulator serves this. What a client
sends has passed the socket before it comes here, and what is answered here passes it afterwards: a capture
made at the socket shows what a capture at the controller's end of the cable would show.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from typing import NamedTuple

from bcapscope.faults.attempts import Attempts
from bcapscope.faults.fault import Ending
from bcapscope.faults.message import Closing, Message, Send
from bcapscope.faults.message import Output as Verdict
from bcapscope.faults.shaper import Shaper
from bcapscope.faults.striker import Striker
from bcapscope.protocol.stream import Splitter
from bcapscope.simulator.event import AnyEvent, Event
from bcapscope.simulator.scenario import Scenario, Trouble
from bcapscope.simulator.simulator import LARGEST_REQUEST, Abort, Output, Peer, Simulator
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Transport
from bcapscope.traffic.question import Questions

MOST_LINES = 1024
"""Clients that are told apart; where there are more, those on UDP go that have been silent for longest."""

_HERE = Endpoint("simulator", 0)


class _Line(NamedTuple):
    """The way to one client and back."""

    peer: Peer
    up: Flow
    down: Flow
    splitter: Splitter | None


class _Cue(NamedTuple):
    """An event that waits for a request."""

    event: AnyEvent
    striker: Striker


def _ignore(news: str) -> None:
    """Take no notice."""


class Stage:
    """A simulator to which things happen.

    Attributes:
        simulator: the controller.
        shaper: the faults of messages at work.
    """

    def __init__(
        self,
        scenario: Scenario,
        simulator: Simulator,
        now: int,
        *,
        seed: int | None = None,
        news: Callable[[str], None] = _ignore,
    ) -> None:
        """Begin to play.

        Args:
            scenario: what is to happen.
            simulator: made with the scenario's profile and beginning.
            now: ns, as the simulator was given.
            seed: other than that of the scenario.
            news: told in words what happens.
        """
        self.simulator = simulator
        self._scenario = scenario
        self._seed = scenario.seed if seed is None else seed
        self._news = news
        epoch = simulator.machine.start.epoch
        self.shaper = Shaper(seed=self._seed, now=now, epoch=epoch)
        self._epoch = epoch
        self._lines: dict[Peer, _Line] = {}
        self._peers: dict[Conversation, Peer] = {}
        self._timed: list[tuple[int, int, AnyEvent]] = []
        self._cues: list[_Cue] = []
        self._questions, self._attempts = Questions(), Attempts()
        self._messages = self._counted = 0
        self._was_in_slave_mode = False
        scenario.fill(simulator.machine.memory)
        self._set_up(scenario.faults, now)

    def datagram(self, peer: Peer, data: bytes, now: int) -> list[Output]:
        """Take a UDP datagram; return what to send."""
        outputs = self._pass_time(now)
        return outputs + self._hear(self._line(peer, Transport.UDP), data, now)

    def connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Take a TCP connection; return False if there are too many, for the caller to close it."""
        self._line(peer, Transport.TCP)
        taken = self.simulator.connect(peer, now, is_stop)
        if not taken:
            self._forget(peer)
        return taken

    def segment(self, peer: Peer, data: bytes, now: int) -> list[Output]:
        """Take bytes of a connection; return what to send."""
        outputs = self._pass_time(now)
        line = self._lines.get(peer)
        if line is None or line.splitter is None:
            return outputs
        for piece in line.splitter.feed(data):
            if self._lines.get(peer) is line:
                outputs += self._hear(line, piece.item.raw, now)
        return outputs

    def disconnect(self, peer: Peer, now: int) -> None:
        """Let go of a client that is gone, unless the controller is not to notice."""
        line = self._lines.get(peer)
        if line is None or self.shaper.passes_end(line.up.conversation):
            self.simulator.disconnect(peer, now)
        self._forget(peer)

    def reset(self, now: int) -> list[Output]:
        """Press the pendant's Reset button."""
        return self._say(self.simulator.reset(now), now)

    def advance(self, now: int) -> list[Output]:
        """Let time pass; return what to send."""
        return self._pass_time(now)

    def due(self, now: int) -> int | None:
        """Return when `advance` is to be called next at the latest; None if nothing is under way."""
        times = (self.simulator.due(now), self.shaper.due(), self._timed[0][0] if self._timed else None)
        return min((time for time in times if time is not None), default=None)

    @property
    def keeps_time(self) -> bool:
        """Whether its time goes on while it gets no processor."""
        return self.simulator.keeps_time

    @property
    def waits(self) -> bool:
        """Whether a call waits for time to pass."""
        return self.simulator.waits

    # what happens

    def _set_up(self, trouble: Trouble, now: int) -> None:
        for each in trouble:
            if not isinstance(each, Event):
                self.shaper.add(each, now)
            elif each.is_timed:
                self._counted += 1
                heapq.heappush(self._timed, (now + each.after, self._counted, each))
            else:
                self._counted += 1
                name = each.name or f"{each.action} {self._counted}"
                self._cues.append(_Cue(each, Striker(each, name, self._seed, now)))

    def _happen(self, event: AnyEvent, now: int) -> list[Output]:
        self._news(event.name or event.action)
        return self._say(event.happen(self.simulator, now), now)

    def _pass_time(self, now: int) -> list[Output]:
        """Let everything happen that is due by now, in the order of its time."""
        outputs: list[Output] = []
        while self._timed and self._timed[0][0] <= now:
            when, _, event = heapq.heappop(self._timed)
            outputs += self._say(self.simulator.advance(when), when)
            outputs += self._happen(event, when)
        outputs += self._do(self.shaper.advance(now), now)
        outputs += self._say(self.simulator.advance(now), now)
        self._look_at_mode(now)
        return outputs

    def _look_at_mode(self, now: int) -> None:
        if not self._was_in_slave_mode and self.simulator.machine.slave.mode is not None:
            self._was_in_slave_mode = True
            self._set_up(self._scenario.in_slave_mode, now)

    # messages

    def _hear(self, line: _Line, data: bytes, now: int) -> list[Output]:
        """Take one message of a client."""
        outputs = self._cued(line, data, now) if self._cues else []
        taken = self.shaper.take(line.up, data, now)
        self._tell(taken.touched)
        return outputs + self._do(taken.outputs, now)

    def _cued(self, line: _Line, data: bytes, now: int) -> list[Output]:
        """Let those events happen that have waited for this message."""
        self._messages += 1
        message = Message(self._messages, line.up, data, now, now + self._epoch)
        message.learn(self._questions, self._attempts)
        outputs: list[Output] = []
        for event, striker in self._cues:
            if striker.matches(message) and striker.wins():
                striker.count()
                outputs += self._happen(event, now)
        return outputs

    def _do(self, verdicts: Iterable[Verdict], now: int) -> list[Output]:
        """Bring to the controller, or to the client, what the faults have left of messages."""
        outputs: list[Output] = []
        for verdict in verdicts:
            if isinstance(verdict, Closing):
                outputs += self._close(verdict, now)
            elif verdict.flow.direction is Direction.REQUEST:
                outputs += self._ask(verdict, now)
            else:
                peer = self._peers.get(verdict.flow.conversation)
                outputs += [] if peer is None else [Output(peer, verdict.data)]
        return outputs

    def _ask(self, send: Send, now: int) -> list[Output]:
        peer = self._peers.get(send.flow.conversation)
        if peer is None:
            return []
        udp = send.flow.conversation.transport is Transport.UDP
        take = self.simulator.datagram if udp else self.simulator.segment
        outputs = self._say(take(peer, send.data, now), now)
        self._look_at_mode(now)
        return outputs

    def _say(self, outputs: Iterable[Output], now: int) -> list[Output]:
        """Send what the controller says through the faults."""
        said: list[Output] = []
        for output in outputs:
            line = self._lines.get(output.peer)
            if line is None:
                said.append(output)
            elif not output.data:
                self._forget(output.peer)
                said.append(output)
            else:
                taken = self.shaper.take(line.down, output.data, now)
                self._tell(taken.touched)
                said += self._do(taken.outputs, now)
        return said

    def _close(self, closing: Closing, now: int) -> list[Output]:
        peer = self._peers.get(closing.conversation)
        if peer is None:
            return []
        self.disconnect(peer, now)
        return [Output(peer, Abort() if closing.how is Ending.RESET else b"")]

    def _tell(self, touched: Iterable[str]) -> None:
        for each in touched:
            self._news(each)

    # clients

    def _line(self, peer: Peer, transport: Transport) -> _Line:
        line = self._lines.pop(peer, None) or self._new_line(peer, transport)
        self._lines[peer] = line
        return line

    def _new_line(self, peer: Peer, transport: Transport) -> _Line:
        if len(self._lines) >= MOST_LINES:
            self._forget(next((each.peer for each in self._lines.values() if each.splitter is None), None))
        conversation = Conversation(_endpoint(peer), _HERE, transport, "we are the server")
        self._peers[conversation] = peer
        splitter = Splitter(limit=LARGEST_REQUEST) if transport is Transport.TCP else None
        up, down = Flow(conversation, Direction.REQUEST), Flow(conversation, Direction.RESPONSE)
        return _Line(peer, up, down, splitter)

    def _forget(self, peer: Peer) -> None:
        line = self._lines.pop(peer, None)
        if line is not None:
            del self._peers[line.up.conversation]
            self.shaper.forget(line.up.conversation)


def _endpoint(peer: Peer) -> Endpoint:
    """Return host and port of a client that is known by its address, as the server knows it."""
    match peer:
        case (_, (str(host), int(port), *_)):
            return Endpoint(host, port)
    return Endpoint(str(peer), 0)
