"""Builds the records of calls from the packets and events of a session."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.errors import Attempt
from bcapscope.live.controller.history_record import HistoryRecord, Initiator, RecordOutcome
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallExecuting,
    CallRefused,
    CallTimedOut,
    LateReply,
    RequesterEvent,
)
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.observation import Direction, Observation

INITIATOR: ContextVar[Initiator] = ContextVar("who", default=Initiator.SCREEN)
"""Who initiated the calls of the current asyncio task: the user or bcapscope."""

MAX_PACKETS = 256
"""Maximum number of packets in one record. A flood of packets must not fill the memory."""


class HistoryRecorder:
    """Records the calls of one session. In a session, each call ends before the next call begins."""

    def __init__(
        self,
        on_record: Callable[[HistoryRecord], None],
        subject_of: Callable[[int, Sequence[Variant]], ObjectHandle | None],
    ) -> None:
        """`subject_of` returns the object that a call uses, given its function id and arguments."""
        self._on_record = on_record
        self._subject_of = subject_of
        self._next_number = 1
        self.last_record: HistoryRecord | None = None
        self._call: _CallInProgress | None = None

    def on_packet(self, observation: Observation) -> None:
        call = self._call
        if observation.flow.direction is Direction.REQUEST and call is None:
            call = self._call = _CallInProgress(observation.time, INITIATOR.get(), asyncio.current_task())
        if call is not None:
            call.add_packet(observation)

    def on_event(self, event: RequesterEvent) -> None:
        call = self._call
        if call is None:
            return
        if isinstance(event, CallExecuting):
            call.notices += 1
        elif isinstance(event, LateReply):
            call.late_replies += 1
        elif isinstance(event, CallAnswered | CallRefused):
            answered = isinstance(event, CallAnswered)
            outcome = RecordOutcome.ANSWERED if answered else RecordOutcome.REFUSED
            self._complete_call(call, outcome, event.attempts, event.reply, event.elapsed)
        elif isinstance(event, CallTimedOut):
            self._complete_call(call, RecordOutcome.UNANSWERED, event.attempts)

    def abandon_own_call(self) -> None:
        """Abandon the call in progress, but only if the current asyncio task made this call."""
        if self._call is not None and self._call.task is asyncio.current_task():
            self.abandon_call()

    def abandon_call(self) -> None:
        if self._call is not None:
            self._complete_call(self._call, RecordOutcome.ABANDONED, ())

    def complete_raw_call(self) -> None:
        """Complete the record of the user's raw bytes. The last frame from the controller is the reply."""
        call = self._call
        if call is None:
            return
        came = [seen.item for seen in call.packets if seen.flow.direction is Direction.RESPONSE]
        reply = next((item for item in reversed(came) if isinstance(item, Frame)), None)
        attempts = (Attempt(0, 0, 0),)
        if reply is None:
            self._complete_call(call, RecordOutcome.UNANSWERED, attempts)
        else:
            outcome = RecordOutcome.REFUSED if is_failure(reply.code) else RecordOutcome.ANSWERED
            self._complete_call(call, outcome, attempts, reply, call.elapsed)

    def _complete_call(
        self,
        call: _CallInProgress,
        outcome: RecordOutcome,
        attempts: tuple[Attempt, ...],
        reply: Frame | None = None,
        took: int | None = None,
    ) -> None:
        """Record a call. `took` is the duration in ns; None if the call ends now."""
        request = call.packets[0].item
        code, arguments = (request.code, request.variants) if isinstance(request, Frame) else (-1, ())
        self._call = None
        self.last_record = HistoryRecord(
            number=self._next_number,
            initiator=call.initiator,
            began=call.began,
            function_id=code,
            arguments=arguments,
            outcome=outcome,
            reply=reply,
            took=max(0, time.time_ns() - call.began) if took is None else took,
            attempts=attempts,
            packets=tuple(call.packets),
            notices=call.notices,
            late_replies=call.late_replies,
            subject=self._subject_of(code, arguments),
        )
        self._next_number += 1
        self._on_record(self.last_record)


@dataclass(slots=True)
class _CallInProgress:
    began: int
    initiator: Initiator
    task: asyncio.Task[object] | None
    packets: list[Observation] = field(default_factory=list)
    elapsed: int = 0
    notices: int = 0
    late_replies: int = 0

    def add_packet(self, observation: Observation) -> None:
        self.elapsed = max(self.elapsed, observation.time - self.began)
        if len(self.packets) < MAX_PACKETS:
            self.packets.append(observation)
