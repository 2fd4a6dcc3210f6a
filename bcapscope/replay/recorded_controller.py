"""Answer a client with the replies of a recorded controller.

The replies contain the recorded handles. Therefore, a client that repeats the recorded calls sends requests
with the recorded handles.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable
from copy import copy

from bcapscope.errors import LocalProtocolError, TooLargeError
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.protocol.tables.hresult import E_NOTIMPL, E_TOO_MUCH_DATA
from bcapscope.replay.replay_script import ReplayScript, ScriptCall
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.call_outcome import CallResult
from bcapscope.simulator.hosted_client import HostedClient
from bcapscope.simulator.simulator import ClientHost, Peer
from bcapscope.traffic.call_kind import CallKind, call_kind_of

IDLE_CLIENT_NS = 2_000_000_000
"""Another client may replace a UDP client after this time in ns without a request. This time exceeds the 1 s
between two attempts of a client that gets no reply (DENSO Wave 2009, How to use the Slave mode).
"""

_SERVICE_START = CallKind(1, None)


class ScriptLookup:
    """Finds the recorded call that answers a request of one client.

    `find` returns the next recorded call with the same function, command and arguments. After the last of
    these calls, `find` returns this last call again. If no recorded call has these arguments, `find` compares
    only function and command. If a client sends another Service_Start after `find` has returned the last
    recorded Service_Start, `find` begins again at the first recorded call.
    """

    def __init__(self, calls: Iterable[ScriptCall]) -> None:
        self._calls: dict[CallKind, list[ScriptCall]] = {}
        self._positions: dict[tuple[CallKind, tuple[Variant, ...]], list[int]] = {}
        self._next: dict[CallKind, int] = {}
        for call in calls:
            kind = _casefolded(call.kind)
            alike = self._calls.setdefault(kind, [])
            self._positions.setdefault((kind, call.arguments), []).append(len(alike))
            alike.append(call)

    def for_new_client(self) -> ScriptLookup:
        lookup = copy(self)
        lookup._next = {}
        return lookup

    def find(self, kind: CallKind, arguments: tuple[Variant, ...]) -> ScriptCall | None:
        """Return the call that answers a request; None if the recording lacks this function and command."""
        kind = _casefolded(kind)
        calls = self._calls.get(kind)
        if calls is None:
            return None
        if kind == _SERVICE_START and self._next.get(kind) == len(calls):
            self._next.clear()
        begin = self._next.get(kind, 0)
        places = self._positions.get((kind, arguments), [])
        index = bisect_left(places, begin)
        if index == len(places) > 0:
            return calls[places[-1]]
        place = places[index] if places else min(begin, len(calls) - 1)
        self._next[kind] = place + 1
        return calls[place]


def _casefolded(kind: CallKind) -> CallKind:
    """Controllers ignore the case of commands."""
    command = kind.command
    return kind if command is None else CallKind(kind.function_id, command.casefold())


class _ReplayClient(HostedClient):
    def __init__(
        self,
        number: int,
        udp: bool,
        reply_reserved: ReplyReserved,
        lookup: ScriptLookup,
        *,
        delays: bool,
        report: Callable[[CallReport, bool], None],
    ) -> None:
        """After each answered call, `report` gets the call and whether its reply comes from the recording."""
        super().__init__(udp, reply_reserved)
        self._number = number
        self._delays = delays
        self._report = report
        self._lookup = lookup
        self._frame: Frame | None = None
        self._script_call: ScriptCall | None = None
        self._began = 0
        self._notice_offsets: deque[int] = deque()

    @property
    def running(self) -> bool:
        return self.due(self._began) is not None

    def poll(self, now: int) -> list[bytes]:
        frames: list[bytes] = []
        while (due := self.due(now)) is not None and due <= now:
            if self._notice_offsets:
                self._notice_offsets.popleft()
                frames.append(self._responder.executing_notice())
            else:
                frames += [self._answer_call(now), *self._start_waiting(now)]
        return frames

    def due(self, now: int) -> int | None:
        if self._frame is None:
            return None
        if self._notice_offsets:
            return self._began + self._notice_offsets[0]
        took = self._script_call.duration if self._script_call is not None and self._delays else 0
        return None if self._is_unanswered else self._began + took

    @property
    def _is_unanswered(self) -> bool:
        return self._frame is not None and self._script_call is not None and self._script_call.hresult is None

    def _start_call(self, frame: Frame, now: int) -> list[bytes]:
        self._frame, self._began = frame, now
        self._script_call = self._lookup.find(call_kind_of(frame), frame.variants)
        self._notice_offsets.clear()
        if self._script_call is not None and self._delays:
            self._notice_offsets.extend(self._script_call.notice_offsets)
        return []

    def _answer_call(self, now: int) -> bytes:
        frame, call = self._frame, self._script_call
        assert frame is not None
        self._frame = None
        is_known = call is not None
        code: int = E_NOTIMPL
        values: tuple[Variant, ...] = ()
        if call is not None and call.hresult is not None:
            code, values = call.hresult, call.values
        try:
            raw = self._responder.answer_call(code, values)
        except TooLargeError:  # recorded over TCP
            code, values = E_TOO_MUCH_DATA, ()
            raw = self._responder.answer_call(code)
        except LocalProtocolError:  # damaged in the recording
            code, values, is_known = E_NOTIMPL, (), False
            raw = self._responder.answer_call(code)
        result = CallResult(code, values[0] if values else None)
        report = CallReport(self._number, frame.code, frame.variants, result, self._began, now)
        self._report(report, is_known)
        return raw


class RecordedController(ClientHost):
    """Plays the role of a recorded controller. Each client gets the recorded replies from the beginning.

    If the recording has no usable reply to a call, the replay answers E_NOTIMPL. `unknown_calls` is the
    number of these calls. The clock of the replay only reproduces recorded delays. Therefore
    `runs_in_real_time` is False: the clock stops while this process gets no processor.
    """

    evictable_after = IDLE_CLIENT_NS
    closes_on_bad_frame = False
    runs_in_real_time = has_running_calls = False

    def __init__(
        self, script: ReplayScript, report: Callable[[Peer, CallReport], None], *, delays: bool = True
    ) -> None:
        super().__init__(self._replay_to_client, report)
        self.unknown_calls = 0
        self._lookup = ScriptLookup(script.calls)
        self._reply_reserved = script.reply_reserved
        self._delays = delays

    def _replay_to_client(
        self, number: int, udp: bool, report: Callable[[CallReport], None]
    ) -> _ReplayClient:
        def on_answered(call: CallReport, is_known: bool) -> None:
            self.unknown_calls += not is_known
            report(call)

        setting = number, udp, self._reply_reserved, self._lookup.for_new_client()
        return _ReplayClient(*setting, delays=self._delays, report=on_answered)
