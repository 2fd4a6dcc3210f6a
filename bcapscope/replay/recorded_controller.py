"""Answer a client with the replies of a recorded controller.

The replies contain the recorded handles, so a client that repeats the recorded calls sends these handles.
`RecordedController` uses no I/O and no clock, and has the interface of a `Simulator`.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TypeAlias

from bcapscope.errors import LocalProtocolError, TooLargeError
from bcapscope.protocol.codec.frame import LARGEST_FRAME, LARGEST_UDP_FRAME, Frame, parse_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.responder import RequestKind, Responder
from bcapscope.protocol.tables.hresult import E_BUSY, E_NOTIMPL, E_TOO_MUCH_DATA
from bcapscope.replay.replay_script import ReplayScript, ScriptCall
from bcapscope.simulator.call_executor import MAX_WAITING, CallReport
from bcapscope.simulator.call_outcome import CallResult
from bcapscope.simulator.simulator import LARGEST_REQUEST, MAX_CLIENTS, STOP_CLIENTS, Peer, SimulatorOutput
from bcapscope.traffic.call_kind import CallKind, call_kind_of

IDLE_CLIENT_NS = 2_000_000_000
"""Time in ns without a request after which another client may take the place of a UDP client. A waiting
client sends its next attempt sooner (DENSO Wave 2009, How to use the Slave mode: 1 s)."""

_SERVICE_START = CallKind(1, None)

_AnsweredCallback: TypeAlias = Callable[[CallReport, bool], None]
"""Called for each answered call, and whether its answer comes from the script."""


class ScriptIndex:
    """Index of a script's calls by function, command and arguments, shared by all clients."""

    def __init__(self, calls: Iterable[ScriptCall]) -> None:
        self.calls: dict[CallKind, list[ScriptCall]] = {}
        self.positions: dict[tuple[CallKind, tuple[Variant, ...]], list[int]] = {}
        for line in calls:
            question = _casefolded(line.kind)
            known = self.calls.setdefault(question, [])
            self.positions.setdefault((question, line.arguments), []).append(len(known))
            known.append(line)


class ScriptLookup:
    """Finds the recorded call that answers a request of one client.

    `find` returns the next recorded call with the same function, command and arguments, or the last such call
    if none is left. If no recorded call has the same arguments, `find` returns the next call with the same
    function and command. A Service_Start after the last recorded Service_Start begins the script again.
    """

    def __init__(self, index: ScriptIndex) -> None:
        self._index = index
        self._next: dict[CallKind, int] = {}

    def find(self, kind: CallKind, arguments: tuple[Variant, ...]) -> ScriptCall | None:
        """Return the recorded call that answers a request; None if no recorded call has its function and
        command."""
        question = _casefolded(kind)
        lines = self._index.calls.get(question)
        if lines is None:
            return None
        if question == _SERVICE_START and self._next.get(question) == len(lines):
            self._next.clear()
        begin = self._next.get(question, 0)
        places = self._index.positions.get((question, arguments), [])
        index = bisect_left(places, begin)
        if index == len(places) > 0:
            return lines[places[-1]]
        place = places[index] if places else min(begin, len(lines) - 1)
        self._next[question] = place + 1
        return lines[place]


def _casefolded(kind: CallKind) -> CallKind:
    """Return the call kind with its command in lower case, because controllers ignore case in commands."""
    command = kind.command
    return kind if command is None else CallKind(kind.function_id, command.casefold())


class _ReplayClient:
    """The replay to one client, which answers one call at a time.

    Attributes:
        splitter: Splits the client's TCP stream into frames; None for a UDP client.
    """

    def __init__(
        self,
        number: int,
        lookup: ScriptLookup,
        responder: Responder,
        *,
        splitter: StreamSplitter | None,
        delays: bool,
        on_answered: _AnsweredCallback,
    ) -> None:
        self.splitter = splitter
        self.last_request_at = 0
        self._number = number
        self._delays = delays
        self._on_answered = on_answered
        self._lookup = lookup
        self._responder = responder
        self._waiting: deque[Frame] = deque()
        self._frame: Frame | None = None
        self._script_call: ScriptCall | None = None
        self._began = 0
        self._notice_offsets: deque[int] = deque()

    def receive(self, frame: Frame, now: int) -> list[bytes]:
        self.last_request_at = now
        decision = self._responder.receive_request(frame)
        if decision.kind is RequestKind.BUSY and self._is_unanswered:
            # The recorded call had no reply, so the current call ends when the client sends another call.
            self._responder.abandon_call()
            decision = self._responder.receive_request(frame)
        if decision.kind is RequestKind.NEW:
            self._start_call(frame, now)
            return []
        if decision.reply is not None:
            return [decision.reply]
        if decision.kind is RequestKind.BUSY:
            if len(self._waiting) >= MAX_WAITING:
                return [self._responder.reply_unremembered(frame, E_BUSY)]
            self._waiting.append(frame)
        return []

    @property
    def due(self) -> int | None:
        """Time when `poll` has the next frame to send, ns; None if no frame is planned."""
        if self._frame is None:
            return None
        if self._notice_offsets:
            return self._began + self._notice_offsets[0]
        took = self._script_call.duration if self._script_call is not None and self._delays else 0
        return None if self._is_unanswered else self._began + took

    def poll(self, now: int) -> Iterator[bytes]:
        while (due := self.due) is not None and due <= now:
            if self._notice_offsets:
                self._notice_offsets.popleft()
                yield self._responder.executing_notice()
                continue
            yield self._answer_call(now)
            while self._waiting and (self._is_unanswered or not self._responder.is_call_running):
                yield from self.receive(self._waiting.popleft(), now)

    @property
    def _is_unanswered(self) -> bool:
        """Whether the recording has no reply to the current call."""
        return self._frame is not None and self._script_call is not None and self._script_call.hresult is None

    def _start_call(self, frame: Frame, now: int) -> None:
        arguments = frame.variants
        self._frame, self._began = frame, now
        self._script_call = self._lookup.find(call_kind_of(frame), arguments)
        self._notice_offsets.clear()
        if self._script_call is not None and self._delays:
            self._notice_offsets.extend(self._script_call.notice_offsets)

    def _answer_call(self, now: int) -> bytes:
        frame, line = self._frame, self._script_call
        assert frame is not None
        self._frame = None
        code: int = E_NOTIMPL
        values: tuple[Variant, ...] = ()
        known = line is not None
        if line is not None and line.hresult is not None:
            code, values = line.hresult, line.values
        try:
            raw = self._responder.answer_call(code, values)
        except TooLargeError:  # recorded over TCP
            code, values = E_TOO_MUCH_DATA, ()
            raw = self._responder.answer_call(code)
        except LocalProtocolError:  # damaged in the recording
            code, values, known = E_NOTIMPL, (), False
            raw = self._responder.answer_call(code)
        arguments = frame.variants
        answer = CallResult(code, values[0] if values else None)
        self._on_answered(CallReport(self._number, frame.code, arguments, answer, self._began, now), known)
        return raw


class RecordedController:
    """Plays the role of a recorded controller. Each client is answered with the whole script.

    Attributes:
        dropped: Number of datagrams that were dropped: damaged, no frame, or from a client beyond the limit.
        unknown_calls: Number of calls that were answered with E_NOTIMPL, because the recording has no such
            call or no usable reply.
        runs_in_real_time: Always False, because the replayed time may stop while the process gets no CPU
            time.
        has_running_calls: Always False, because a call waits only for its recorded delay.
    """

    runs_in_real_time = has_running_calls = False

    def __init__(
        self, script: ReplayScript, report: Callable[[Peer, CallReport], None], *, delays: bool = True
    ) -> None:
        """Start without clients.

        Args:
            delays: True to reply after the time that the recorded controller took; False to reply at once.
        """
        self.dropped = 0
        self.unknown_calls = 0
        self._index = ScriptIndex(script.calls)
        self._reply_reserved = script.reply_reserved
        self._report = report
        self._delays = delays
        self._clients: dict[Peer, _ReplayClient] = {}
        self._last_client_number = 0
        self._templates = FrameTemplates()

    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Process a UDP datagram; return the outputs to send."""
        items = parse_datagram(data, self._templates) if len(data) <= LARGEST_UDP_FRAME else ()
        frame = items[0] if len(items) == 1 else None
        if not isinstance(frame, Frame) or frame.problems:
            self.dropped += 1
            return []
        part = self._clients.get(peer)
        if part is None:
            if not self._has_room(now):
                self.dropped += 1
                return []
            part = self._add_client(peer, udp=True, now=now)
        return self._outputs(peer, part, [frame], now)

    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool:
        """Accept a TCP connection. Return False if there are too many connections; the caller then closes
        this one."""
        if len(self._clients_on(udp=False)) >= MAX_CLIENTS + STOP_CLIENTS * is_stop:
            return False
        self._add_client(peer, udp=False, now=now)
        return True

    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]:
        """Process bytes of a TCP connection; return the outputs to send. Damaged frames and other bytes are
        skipped."""
        part = self._clients.get(peer)
        if part is None or part.splitter is None:
            return []
        items = [piece.item for piece in part.splitter.feed(data)]
        frames = [item for item in items if isinstance(item, Frame) and not item.problems]
        return self._outputs(peer, part, frames, now)

    def on_disconnect(self, peer: Peer, now: int) -> None:
        self._clients.pop(peer, None)

    def reset(self, now: int) -> list[SimulatorOutput]:
        """Drop every client; return the outputs that close the TCP connections."""
        peers = [peer for peer, part in self._clients.items() if part.splitter is not None]
        self._clients.clear()
        return [SimulatorOutput(peer, b"") for peer in peers]

    def advance(self, now: int) -> list[SimulatorOutput]:
        return [each for peer, part in self._clients.items() for each in self._due_outputs(peer, part, now)]

    def due(self, now: int) -> int | None:
        """Return the time by which `advance` must be called next, ns; None if no frame is planned."""
        times = (part.due for part in self._clients.values())
        return min((time for time in times if time is not None), default=None)

    def _outputs(
        self, peer: Peer, client: _ReplayClient, frames: list[Frame], now: int
    ) -> list[SimulatorOutput]:
        outputs: list[SimulatorOutput] = []
        for frame in frames:
            outputs += [SimulatorOutput(peer, raw) for raw in client.receive(frame, now)]
            outputs += self._due_outputs(peer, client, now)
        return outputs

    def _due_outputs(self, peer: Peer, client: _ReplayClient, now: int) -> Iterator[SimulatorOutput]:
        return (SimulatorOutput(peer, raw) for raw in client.poll(now))

    def _on_answered(self, peer: Peer, report: CallReport, known: bool) -> None:
        self.unknown_calls += not known
        self._report(peer, report)

    def _clients_on(self, udp: bool) -> dict[Peer, _ReplayClient]:
        """Return the clients on UDP or the clients on TCP, because each transport has its own limit of
        clients."""
        return {peer: part for peer, part in self._clients.items() if (part.splitter is None) is udp}

    def _has_room(self, now: int) -> bool:
        """Return whether another UDP client fits. If necessary, drop the client that was silent longest."""
        parts = self._clients_on(udp=True)
        if len(parts) < MAX_CLIENTS:
            return True
        silent = min(parts, key=lambda peer: parts[peer].last_request_at)
        if now - parts[silent].last_request_at < IDLE_CLIENT_NS:
            return False
        del self._clients[silent]
        return True

    def _add_client(self, peer: Peer, udp: bool, now: int) -> _ReplayClient:
        self._last_client_number += 1
        largest = LARGEST_UDP_FRAME if udp else LARGEST_FRAME
        responder = Responder(
            expects_retries=udp, reply_reserved=self._reply_reserved, largest_answer=largest
        )
        told, prompter = partial(self._on_answered, peer), ScriptLookup(self._index)
        splitter = None if udp else StreamSplitter(limit=LARGEST_REQUEST, templates=self._templates)
        part = _ReplayClient(
            self._last_client_number,
            prompter,
            responder,
            splitter=splitter,
            delays=self._delays,
            on_answered=told,
        )
        self._clients[peer] = part
        part.last_request_at = now
        return part
