"""Run all rules of `diagnose` in one pass over the traffic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import TypeAlias

from bcapscope.analysis.call_selection import CallSelection
from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.finding import NO_TRAFFIC, Finding, TrafficTotals
from bcapscope.analysis.finding_collector import FindingCollector
from bcapscope.analysis.rules import CHECKERS
from bcapscope.analysis.rules.rule_checker import (
    CallHealth,
    ClientEnd,
    Occurrence,
    RuleChecker,
    call_observations,
)
from bcapscope.analysis.rules.wire_rules import CHECKED_FROM_BYTES
from bcapscope.analysis.slave.selected_sessions import SelectedSlaveSessions
from bcapscope.analysis.slave.session_detector import SlaveSessionDetector
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.protocol.codec.frame import Malformed
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call, FrameObservation, StrayReply
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Conversation, Flow, Observation
from bcapscope.traffic.pipeline import PipelineSubscriber, overriding_methods
from bcapscope.traffic.slave_mode_tracker import SlaveModeChange

MAX_CALL_KINDS = 4096
"""Maximum number of kinds of call whose checkers are cached. A full cache is emptied."""

MAX_FLOWS = 65536
"""Maximum number of flows in the set of known flows. A full set is emptied."""

_CallHandler: TypeAlias = Callable[[Call, ClientState], None]


class Diagnosis(PipelineSubscriber):
    """Finds what went wrong in the traffic, in bounded memory.

    You can call `findings`, `totals` and `remaining_sessions` at any time. These methods change nothing, and
    return the same results as if the traffic ended now.
    """

    needs_targets = True

    def __init__(
        self,
        is_selected: Callable[[Call], bool] | None = None,
        on_slave_session: Callable[[SlaveSession], object] | None = None,
    ) -> None:
        """Create a diagnosis.

        Args:
            is_selected: Function that selects calls; None to select all calls. The rules check all calls, but
                `findings` returns only findings about selected calls, and the causes of these findings.
            on_slave_session: Function that receives each complete slave-mode session. If `is_selected` is
                given, `on_slave_session` receives only sessions with selected set points.
                `remaining_sessions` returns the incomplete sessions.
        """
        self._collector = FindingCollector()
        self._report_occurrence = self._collector.add_occurrence
        self._selection: CallSelection | None = None
        self._selected_sessions: SelectedSlaveSessions | None = None
        self._on_slave_session = on_slave_session
        if is_selected is not None:
            self._selection = CallSelection(is_selected, self._collector.add_occurrence)
            self._report_occurrence = self._selection.add_occurrence
            self._on_slave_session = None
            if on_slave_session is not None:
                self._selected_sessions = SelectedSlaveSessions(is_selected, on_slave_session)
        self._clients = ClientRegistry(self._drop_client)
        self._session_detector = SlaveSessionDetector()
        self._checkers = [checker(self._report_occurrence, self._clients) for checker in CHECKERS]
        self._set_point_handlers = [each.on_call for each in self._checkers if each.needs_every_set_point]
        self._suspect_frame_handlers = overriding_methods(self._checkers, RuleChecker.on_suspect_frame)
        self._dropped_calls = self._not_followed = 0
        self._handlers_by_kind: dict[tuple[CallKind, CallHealth], tuple[_CallHandler, ...]] = {}
        self._flows: set[Flow] = set()
        self._first: Observation | None = None
        self._last: Observation | None = None

    def on_frame(self, observation: Observation) -> None:
        item = observation.item
        if self._selection is not None:
            self._selection.on_frame(observation)
        if observation.flow not in self._flows:
            self._on_new_flow(observation)
        self._last = observation
        if item.__class__ is Malformed or len(item.raw) >= CHECKED_FROM_BYTES:
            for check in self._suspect_frame_handlers:
                check(observation)

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if self._selection is not None:
            self._selection.on_call(call)
        if self._selected_sessions is not None:
            self._selected_sessions.on_call(call, target)
        client = self._clients.client_of(call)
        client.target_object = target
        for seen in call_observations(call):
            self._check_frame(seen)
        self._not_followed += call.evicted
        key = call.kind, _health_of(call)
        handlers = self._handlers_by_kind.get(key)
        if handlers is None:
            handlers = self._handlers_for(key)
        for check in handlers:
            check(call, client)
        self._on_slave_sessions(self._session_detector.add_call(call))
        client.on_call(call)

    def on_set_points(self, calls: Sequence[Call]) -> None:
        client = self._clients.client_of(calls[0])
        if self._selection is not None:
            for call in calls:
                self._selection.on_call(call)
        if self._selected_sessions is not None:
            self._selected_sessions.on_set_points(calls)
        for check in self._set_point_handlers:
            for call in calls:
                check(call, client)
        client.on_set_points(calls)
        sessions = self._session_detector.add_set_points(calls)
        if sessions:
            self._on_slave_sessions(sessions)

    def on_stray_reply(self, stray: StrayReply) -> None:
        if self._selection is not None:
            self._selection.on_stray_reply(stray)
        self._check_frame(stray.observation)
        for checker in self._checkers:
            checker.on_stray_reply(stray)

    def on_slave_mode(self, change: SlaveModeChange) -> None:
        self._clients.client_of(change.call).on_slave_mode(change)

    def _check_frame(self, observation: FrameObservation) -> None:
        """If the frame has problems and is smaller than `CHECKED_FROM_BYTES`, pass it to the checkers.
        `on_frame` has already passed every frame of at least this size, with or without problems.
        """
        if observation.item.problems and len(observation.item.raw) < CHECKED_FROM_BYTES:
            for check in self._suspect_frame_handlers:
                check(observation)

    def _on_slave_sessions(self, sessions: Sequence[SlaveSession]) -> None:
        for session in sessions:
            for occurrence in self._session_occurrences(session):
                self._report_occurrence(occurrence)
            client = self._clients.find(session.conversation)
            if client is not None and session.exit.reason is ExitReason.SILENT:
                client.silent_session = session
            if self._on_slave_session is not None:
                self._on_slave_session(session)

    def _session_occurrences(self, session: SlaveSession) -> Iterator[Occurrence]:
        return chain.from_iterable(each.session_occurrences(session) for each in self._checkers)

    def on_conversation_closed(self, conversation: Conversation) -> None:
        self._flows = {flow for flow in self._flows if flow.conversation is not conversation}
        self._on_slave_sessions(self._session_detector.close_conversation(conversation))
        self._clients.on_conversation_closed(conversation)
        for checker in self._checkers:
            checker.on_conversation_closed(conversation)

    def findings(self, ended_at: int = 0, clients_present: bool = False) -> tuple[Finding, ...]:
        """Return all findings, root cause first.

        Args:
            ended_at: Time in ns since 1970. The traffic ended at `ended_at` or at the last frame, whichever
                is later.
            clients_present: True if it is known that silent clients are still connected.
        """
        at_end = self._end_occurrences(self._end_time(ended_at), clients_present)
        provisional = at_end if self._selection is None else self._selection.provisional_occurrences(at_end)
        return self._collector.findings(provisional)

    def remaining_sessions(self, ended_at: int = 0) -> Sequence[SlaveSession]:
        """Return the sessions not yet passed to `on_slave_session`. For `ended_at`, see `findings`."""
        detector = self._selected_sessions or self._session_detector
        return detector.remaining_sessions(self._end_time(ended_at))

    def totals(self, ended_at: int = 0) -> TrafficTotals:
        """Return how much traffic there was so far. For `ended_at`, see `findings`."""
        first, last = self._first, self._last
        if first is None or last is None:
            return NO_TRAFFIC
        calls = self._dropped_calls + sum(client.call_count for client in self._clients)
        selected = None if self._selection is None else self._selection.selected_calls
        frames, lasted = last.number - first.number + 1, self._end_time(ended_at) - first.time
        clients = self._clients.clients_seen
        return TrafficTotals(frames, calls, clients, lasted, self._not_followed, selected, first.time)

    def new_findings(self) -> tuple[Finding, ...]:
        """Return the findings since the previous call of `new_findings`, without links to their causes."""
        return self._collector.new_findings()

    def _end_time(self, ended_at: int = 0) -> int:
        return max(ended_at, self._last.time if self._last is not None else 0)

    def _end_occurrences(self, ended_at: int, clients_present: bool) -> Iterator[Occurrence]:
        silent_sessions = {}
        for session in self._session_detector.remaining_sessions(ended_at):
            yield from self._session_occurrences(session)
            if session.exit.reason is ExitReason.SILENT:
                silent_sessions[session.conversation] = session
        for client in self._clients:
            silent = silent_sessions.get(client.conversation, client.silent_session)
            yield from self._client_occurrences(ClientEnd(client, ended_at, clients_present, silent))

    def _client_occurrences(self, end: ClientEnd) -> Iterator[Occurrence]:
        return chain.from_iterable(each.end_occurrences(end) for each in self._checkers)

    def _on_new_flow(self, observation: Observation) -> None:
        if self._first is None:
            self._first = observation
        if len(self._flows) >= MAX_FLOWS:
            self._flows.clear()
        self._flows.add(observation.flow)
        for checker in self._checkers:
            checker.on_new_flow(observation)

    def _handlers_for(self, key: tuple[CallKind, CallHealth]) -> tuple[_CallHandler, ...]:
        if len(self._handlers_by_kind) >= MAX_CALL_KINDS:
            self._handlers_by_kind.clear()
        handlers = tuple(each.on_call for each in self._checkers if each.wants_call(*key))
        self._handlers_by_kind[key] = handlers
        return handlers

    def _drop_client(self, client: ClientState) -> None:
        self._dropped_calls += client.call_count
        end = ClientEnd(client, self._end_time(), False, client.silent_session)
        for occurrence in self._client_occurrences(end):
            self._report_occurrence(occurrence)
        for checker in self._checkers:
            checker.drop_client(client)


def _health_of(call: Call) -> CallHealth:
    reply = call.reply
    if reply is not None and is_failure(reply.item.code):
        return CallHealth.REFUSED
    return CallHealth.SMOOTH if reply is not None and call.is_plain else CallHealth.TROUBLED
