"""The controller's side of a script: answers a client as the controller did when it was recorded.

The handles are the recorded ones, as it is we who give them. No I/O and no clock; it can stand where a
`Simulator` stands.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TypeAlias

from bcapscope.errors import LocalProtocolError, TooLargeError
from bcapscope.protocol.frame import LARGEST_FRAME, LARGEST_UDP_FRAME, Frame, parse_datagram
from bcapscope.protocol.hresult import E_BUSY, E_NOTIMPL, E_TOO_MUCH_DATA
from bcapscope.protocol.responder import Responder, Verdict
from bcapscope.protocol.stream import Splitter
from bcapscope.protocol.variant import Variant
from bcapscope.replay.script import Line, Script
from bcapscope.simulator.conversation import MOST_WAITING, Report
from bcapscope.simulator.outcome import Answer
from bcapscope.simulator.simulator import KEPT, LARGEST_REQUEST, MOST_CLIENTS, Output, Peer
from bcapscope.traffic.question import Question, question_of

FORGOTTEN_AFTER = 2_000_000_000
"""ns of silence after which a UDP client makes room for another: longer than between two tries of one that
waits (DENSO Wave 2009, How to use the Slave mode: 1 s)."""

_SERVICE_START = Question(1, None)

_Told: TypeAlias = Callable[[Report, bool], None]
"""Is given each call that is answered, and whether there was a line for it."""


class Index:
    """The lines of a script, by what was asked; all clients share it."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self.lines: dict[Question, list[Line]] = {}
        self.places: dict[tuple[Question, tuple[Variant, ...]], list[int]] = {}
        for line in lines:
            question = _folded(line.question)
            known = self.lines.setdefault(question, [])
            self.places.setdefault((question, line.arguments), []).append(len(known))
            known.append(line)


class Prompter:
    """Finds the line that answers a request of one client.

    That is the next one with the same function, command and arguments; where there is none any more, the
    last of them that was; else the next with the same function and command. After the last recorded
    Service_Start the next one begins from the top.
    """

    def __init__(self, index: Index) -> None:
        self._index = index
        self._next: dict[Question, int] = {}

    def find(self, asked: Question, arguments: tuple[Variant, ...]) -> Line | None:
        """Return the line; None where nothing like it was recorded."""
        question = _folded(asked)
        lines = self._index.lines.get(question)
        if lines is None:
            return None
        if question == _SERVICE_START and self._next.get(question) == len(lines):
            self._next.clear()
        begin = self._next.get(question, 0)
        places = self._index.places.get((question, arguments), [])
        index = bisect_left(places, begin)
        if index == len(places) > 0:
            return lines[places[-1]]
        place = places[index] if places else min(begin, len(lines) - 1)
        self._next[question] = place + 1
        return lines[place]


def _folded(question: Question) -> Question:
    """Controllers do not tell capital letters from small ones in commands."""
    command = question.command
    return question if command is None else Question(question.function_id, command.casefold())


class _Part:
    """What is said to one client, one call after another.

    Attributes:
        splitter: of what comes over TCP; None on UDP.
        heard: when it last sent something, ns.
    """

    def __init__(
        self, number: int, prompter: Prompter, responder: Responder, *, udp: bool, delays: bool, told: _Told
    ) -> None:
        self.splitter = None if udp else Splitter(limit=LARGEST_REQUEST)
        self.heard = 0
        self._number = number
        self._delays = delays
        self._told = told
        self._prompter = prompter
        self._responder = responder
        self._waiting: deque[Frame] = deque()
        self._frame: Frame | None = None
        self._line: Line | None = None
        self._began = 0
        self._notices: deque[int] = deque()

    def receive(self, frame: Frame, now: int) -> list[bytes]:
        """Take a request; return the frames to send at once."""
        self.heard = now
        decision = self._responder.receive(frame)
        if decision.verdict is Verdict.BUSY and self._is_mute:
            # A call that had no answer when it was recorded is over when its client goes on.
            self._responder.abandon()
            decision = self._responder.receive(frame)
        if decision.verdict is Verdict.NEW:
            self._begin(frame, now)
            return []
        if decision.reply is not None:
            return [decision.reply]
        if decision.verdict is Verdict.BUSY:
            if len(self._waiting) >= MOST_WAITING:
                return [self._responder.reply(frame, E_BUSY)]
            self._waiting.append(frame)
        return []

    @property
    def due(self) -> int | None:
        """When `poll` has something to send, ns; None while there is no call."""
        if self._frame is None:
            return None
        if self._notices:
            return self._began + self._notices[0]
        took = self._line.took if self._line is not None and self._delays else 0
        return None if self._is_mute else self._began + took

    def poll(self, now: int) -> Iterator[bytes]:
        """Yield the frames that are due."""
        while (due := self.due) is not None and due <= now:
            if self._notices:
                self._notices.popleft()
                yield self._responder.notice()
                continue
            yield self._answer(now)
            while self._waiting and (self._is_mute or not self._responder.running):
                yield from self.receive(self._waiting.popleft(), now)

    @property
    def _is_mute(self) -> bool:
        """Whether a call is under way that had no answer."""
        return self._frame is not None and self._line is not None and self._line.hresult is None

    def _begin(self, frame: Frame, now: int) -> None:
        arguments = frame.variants
        self._frame, self._began = frame, now
        self._line = self._prompter.find(question_of(frame), arguments)
        self._notices.clear()
        if self._line is not None and self._delays:
            self._notices.extend(self._line.notices)

    def _answer(self, now: int) -> bytes:
        frame, line = self._frame, self._line
        assert frame is not None
        self._frame = None
        code: int = E_NOTIMPL
        values: tuple[Variant, ...] = ()
        known = line is not None
        if line is not None and line.hresult is not None:
            code, values = line.hresult, line.values
        try:
            raw = self._responder.answer(code, values)
        except TooLargeError:  # it went over TCP when it was recorded
            code, values = E_TOO_MUCH_DATA, ()
            raw = self._responder.answer(code)
        except LocalProtocolError:  # it was damaged when it was recorded
            code, values, known = E_NOTIMPL, (), False
            raw = self._responder.answer(code)
        arguments = frame.variants
        answer = Answer(code, values[0] if values else None)
        self._told(Report(self._number, frame.code, arguments, answer, self._began, now), known)
        return raw


class StandIn:
    """Stands in for a controller that was recorded; every client hears the whole script.

    Attributes:
        dropped: datagrams that were no sound frame, or came from a client too many.
        unknown: calls of which nothing like them was recorded, or no answer that can be given again; they
            are answered E_NOTIMPL.
        keeps_time: its time may stand still while it gets no processor.
        waits: no call waits for anything but its delay.
    """

    keeps_time = waits = False

    def __init__(
        self, script: Script, report: Callable[[Peer, Report], None], *, delays: bool = True
    ) -> None:
        """Begin.

        Args:
            script: what to answer.
            report: called with the client and each call that is answered.
            delays: answer after the time that the controller took, instead of at once.
        """
        self.dropped = 0
        self.unknown = 0
        self._index = Index(script.lines)
        self._replies = script.replies
        self._report = report
        self._delays = delays
        self._parts: dict[Peer, _Part] = {}
        self._number = 0

    def datagram(self, peer: Peer, data: bytes, now: int) -> list[Output]:
        """Take a UDP datagram; return what to send."""
        items = parse_datagram(data) if len(data) <= LARGEST_UDP_FRAME else ()
        frame = items[0] if len(items) == 1 else None
        if not isinstance(frame, Frame) or frame.problems:
            self.dropped += 1
            return []
        part = self._parts.get(peer)
        if part is None:
            if not self._has_room(now):
                self.dropped += 1
                return []
            part = self._add(peer, udp=True, now=now)
        return self._outputs(peer, part, [frame], now)

    def connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Take a TCP connection; return False if there are too many, for the caller to close it."""
        if len(self._of(udp=False)) >= MOST_CLIENTS + KEPT * is_stop:
            return False
        self._add(peer, udp=False, now=now)
        return True

    def segment(self, peer: Peer, data: bytes, now: int) -> list[Output]:
        """Take bytes of a connection; return what to send. Bytes that are no sound frame are skipped."""
        part = self._parts.get(peer)
        if part is None or part.splitter is None:
            return []
        items = [piece.item for piece in part.splitter.feed(data)]
        frames = [item for item in items if isinstance(item, Frame) and not item.problems]
        return self._outputs(peer, part, frames, now)

    def disconnect(self, peer: Peer, now: int) -> None:
        """Forget a client that is gone."""
        self._parts.pop(peer, None)

    def reset(self, now: int) -> list[Output]:
        """Forget every client; return what to send, which closes the connections."""
        peers = [peer for peer, part in self._parts.items() if part.splitter is not None]
        self._parts.clear()
        return [Output(peer, b"") for peer in peers]

    def advance(self, now: int) -> list[Output]:
        """Let time pass; return what to send."""
        return [each for peer, part in self._parts.items() for each in self._polled(peer, part, now)]

    def due(self, now: int) -> int | None:
        """Return when `advance` is to be called next at the latest; None if nothing is under way."""
        times = (part.due for part in self._parts.values())
        return min((time for time in times if time is not None), default=None)

    def _outputs(self, peer: Peer, part: _Part, frames: list[Frame], now: int) -> list[Output]:
        outputs: list[Output] = []
        for frame in frames:
            outputs += [Output(peer, raw) for raw in part.receive(frame, now)]
            outputs += self._polled(peer, part, now)
        return outputs

    def _polled(self, peer: Peer, part: _Part, now: int) -> Iterator[Output]:
        return (Output(peer, raw) for raw in part.poll(now))

    def _told(self, peer: Peer, report: Report, known: bool) -> None:
        self.unknown += not known
        self._report(peer, report)

    def _of(self, udp: bool) -> dict[Peer, _Part]:
        """Return the clients of a transport: those of one never take the room of the other's."""
        return {peer: part for peer, part in self._parts.items() if (part.splitter is None) is udp}

    def _has_room(self, now: int) -> bool:
        """Tell whether there is room for a UDP client, perhaps after forgetting one that is silent."""
        parts = self._of(udp=True)
        if len(parts) < MOST_CLIENTS:
            return True
        silent = min(parts, key=lambda peer: parts[peer].heard)
        if now - parts[silent].heard < FORGOTTEN_AFTER:
            return False
        del self._parts[silent]
        return True

    def _add(self, peer: Peer, udp: bool, now: int) -> _Part:
        self._number += 1
        largest = LARGEST_UDP_FRAME if udp else LARGEST_FRAME
        responder = Responder(retries=udp, replies=self._replies, largest=largest)
        told, prompter = partial(self._told, peer), Prompter(self._index)
        part = _Part(self._number, prompter, responder, udp=udp, delays=self._delays, told=told)
        self._parts[peer] = part
        part.heard = now
        return part
