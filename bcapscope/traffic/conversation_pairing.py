"""Pair the frames of one conversation into calls. `pairing_states` defines the states of a call."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.hresult import E_BUSY, S_EXECUTING
from bcapscope.traffic.call import Call, CallFrame, CallState, FrameObservation, FrameRole, StrayReply
from bcapscope.traffic.call_kind import CallKinds
from bcapscope.traffic.capture_point import CapturePoint, CrossingWindow
from bcapscope.traffic.client_timeout import SHORTEST_TIMEOUT_NS, ShownTimeouts, waits_since
from bcapscope.traffic.frame_index import FrameIndexes
from bcapscope.traffic.handle_sequence import OPENERS, HandleSequence
from bcapscope.traffic.observation import Conversation, Direction, Transport
from bcapscope.traffic.pairing_states import AWAITING_REPLY, TRANSITIONS, CallEvent, copy_event
from bcapscope.traffic.pairing_windows import (
    COPIES_WITHIN_NS,
    FRAME_COST,
    LARGE_CALL,
    LATE_WITHIN_NS,
    MAX_EXTRA_FRAMES,
    RETRY_WITHIN_NS,
    mark_unanswerable,
    unanswered_settles_at,
)
from bcapscope.traffic.requests_only import RequestsOnlyEvidence
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedFieldUsage
from bcapscope.traffic.serial_table import SerialTable
from bcapscope.traffic.unseen_attempts import UnseenRequests, find_retried_call, is_later, settle_continuation

SERVICE_START = 1

_WAITING, _ANSWERED, _SETTLED = CallState.WAITING, CallState.ANSWERED, CallState.SETTLED
_EXPIRY, _EVICTION = CallEvent.EXPIRY, CallEvent.EVICTION


class ConversationPairing:
    """Pairs the frames of one conversation, and yields its completed calls, oldest first."""

    def __init__(
        self,
        conversation: Conversation,
        latest_evicted: int,
        budget: ByteBudget | None = None,
        kinds: CallKinds | None = None,
        taken_at: CapturePoint | None = None,
    ) -> None:
        """Start without calls.

        Args:
            latest_evicted: Call number of the latest evicted call that may belong to this conversation; 0 if
                there is none.
            budget: Counts the bytes of all open calls, in all conversations.
            kinds: Call kinds of the requests of all conversations.
            taken_at: Where the capture was taken; None if unknown.
        """
        self.open_calls: deque[Call] = deque()
        self._budget = budget or ByteBudget()
        self._conversation = conversation
        self._latest_evicted = latest_evicted
        self._kind_of = (kinds or CallKinds()).kind_of
        self._is_tcp = conversation.transport is Transport.TCP
        self._reserved_usage = ReservedFieldUsage()
        # Value of the reserved field in the client's newest captured first attempt; -1 if unknown. On UDP,
        # the attribute is 0 or 1, and 1 means any value except 0.
        self._first_reserved = -1
        self._serials = SerialTable()
        self._by_serial = self._serials.open_calls
        self._newest_call: Call | None = None
        self._frame_indexes = FrameIndexes()
        self._extra_frames = 0  # total number of frames that open calls hold in `Call.other_frames`
        self._latest_overfull = 0  # `Call.number` of the latest call that exceeded MAX_EXTRA_FRAMES
        self._session_call = 0  # `Call.number` of the latest Service_Start call
        self._latest_answered = 0  # highest `Call.number` of an answered call
        # call number and reply time of each call that was answered while an older call was open
        self._answered_early: deque[tuple[int, int]] = deque()
        self._handles = HandleSequence()
        self._timeouts = ShownTimeouts()
        self._crossing = CrossingWindow(taken_at)
        self._requests_only = RequestsOnlyEvidence()
        self._unseen_requests = UnseenRequests()
        # True if frames of the controller were captured, or are known to be missing. An ordinary reply to a
        # call without retries sets only `_latest_answered`.
        self._response_seen = False
        self._reused_serials = self._serials.reused
        self._release_serial = self._serials.release

    @property
    def memory_bytes(self) -> int:
        """Memory in bytes that the frames of all open calls take, with overhead."""
        return sum(call.memory_bytes for call in self.open_calls)

    def add_request(self, observation: FrameObservation, frame: Frame, number: int) -> bool:
        """Add a request; return True if the request starts a call. The new call gets the number `number`."""
        serial, reserved = frame.serial, frame.reserved
        if self._unseen_requests.waiting:
            strays = self._unseen_requests.pop_before(serial)
            if strays:
                return self._add_after_strays(strays, observation, frame, number)
        prior = self._by_serial.get(serial)
        if prior is not None and self._add_to_prior(prior, observation, frame):
            return False
        if reserved and reserved != serial and not self._is_tcp:
            return self._add_later_attempt(observation, frame, number)
        if not reserved and 0 in self._by_serial:
            # If a first attempt has serial 0, the reserved field of its retries is 0. A retry with 0 in the
            # reserved field looks like a first attempt. Old clients may use serial 0 (start-jsk/denso
            # b-Cap.c).
            call = self._by_serial[0]
            is_repeated = call.reply is None and call.request.item.raw[9:] == frame.raw[9:]
            if is_repeated and call is self._newest_call:
                self._add_retry(call, observation, frame)
                return False
        if (reserved if self._is_tcp else reserved != 0) != self._first_reserved:
            self._learn_from_first(serial, reserved)
        self._start_call(observation, frame, number)
        return True

    def add_reply(self, observation: FrameObservation, frame: Frame) -> StrayReply | None:
        """Add a reply or notice; return it as a stray reply if it belongs to no open call."""
        serial = frame.serial
        call = self._by_serial.get(serial)
        if self._reused_serials and serial in self._reused_serials:
            oldest = self._serials.oldest_reused(serial, is_answered=frame.code != S_EXECUTING)
            if isinstance(oldest, int):
                return self._stray_reply(observation, oldest)
            self._add_further_reply(oldest, observation, frame)
            return None
        if call is None:
            self._response_seen = True
            return self._stray_reply(observation, self._serials.settled_call(serial))
        if (
            frame.reserved or self._first_reserved
        ) and self._reserved_usage.reply_reserved is ReplyReserved.UNKNOWN:
            self._learn_from_reply(call, frame)
        if (
            call.other_frames
            or call.state is not _WAITING
            or frame.code == S_EXECUTING
            or call.last_attempt.item.serial != serial
        ):
            self._add_further_reply(call, observation, frame)
        else:  # nearly all replies take this shortcut, which is twice as fast as `_apply`
            call.state = _ANSWERED
            self._accept_reply(call, observation, frame)
        return None

    def add_gap(self, direction: Direction) -> None:
        """Record that the capture lacks bytes that the client or the controller sent.

        Controllers answer in order, so the missing bytes may contain the reply to any call that began after
        the latest answered call, or the reply to a retry of the latest answered call.
        """
        if direction is Direction.RESPONSE:
            self._response_seen = True
            for call in self.open_calls:
                call.reply_missed |= call.reply is None and call.number >= self._latest_answered

    def add_undelivered_reply(self, observation: FrameObservation, frame: Frame) -> None:
        """Add a reply or notice that the controller sent, and that did not reach the client's side."""
        call = self._by_serial.get(frame.serial)
        if call is not None:
            is_notice = frame.code == S_EXECUTING
            self._apply(call, CallEvent.NOTICE if is_notice else CallEvent.UNDELIVERED_REPLY, observation)

    def add_own_request(self, observation: FrameObservation, frame: Frame) -> None:
        """Process a request that the proxy sent on its own. `add_own_request` adds the request to a call only
        if the request repeats an attempt of the call.
        """
        prior = self._by_serial.get(frame.serial)
        if prior is not None:
            self._add_to_prior(prior, observation, frame)

    def pop_settled(self, now: int) -> Iterator[Call]:
        """Yield the calls that can get no further frame after the time `now`."""
        waiting = self.open_calls
        if waiting and waiting[0].number <= self._latest_overfull:
            yield from self.evict_oldest(sum(call.number <= self._latest_overfull for call in waiting))
        while waiting:
            call = waiting[0]
            if call.reply is None:
                settles = unanswered_settles_at(call, self._latest_answered, self._answered_early)
            else:
                settles = call.last_activity
                if not self._is_tcp:
                    settles += RETRY_WITHIN_NS if call is self._newest_call else COPIES_WITHIN_NS
            if settles > now:
                break
            call.no_reply_expected = not call.abandoned_at
            yield self._finish_call(waiting.popleft(), _EXPIRY)

    def evict_oldest(self, count: int) -> Iterator[Call]:
        """Yield the `count` oldest open calls, even if further frames may belong to them."""
        newest = self._newest_call
        for _ in range(min(count, len(self.open_calls))):
            call = self.open_calls.popleft()
            # at least `LATE_WITHIN_NS` passed from `abandoned_at` to the start of the newest call
            is_past = newest is not None and 0 < call.abandoned_at <= newest.request.time - LATE_WITHIN_NS
            event = _EXPIRY if is_past else _EVICTION
            self._latest_evicted = max(self._latest_evicted, call.number)
            yield self._finish_call(call, event)

    def close(self, now: int) -> Iterator[Call]:
        """Yield all open calls, because the traffic of the conversation has ended.

        `now` is the time when the capture ended, ns since 1970; 0 if nothing was captured after the
        conversation.
        """
        mark_unanswerable(self._conversation, self.open_calls, now)
        while self.open_calls:
            call = self.open_calls.popleft()
            is_overfull = call.number <= self._latest_overfull
            yield self._finish_call(call, _EVICTION if is_overfull else _EXPIRY)

    def _apply(self, call: Call, event: CallEvent, observation: FrameObservation) -> None:
        """Add a frame to a call, and change the call's state as `TRANSITIONS` says."""
        self._response_seen |= observation.flow.direction is Direction.RESPONSE
        state, role, reply_becomes = TRANSITIONS[call.state, event]
        call.state = state
        if role is FrameRole.REPLY:
            self._accept_reply(call, observation, observation.item)
            return
        if role is FrameRole.REQUEST:
            self._replace_request(call, observation)
            return
        if reply_becomes is not None and call.reply is not None:
            self._keep_frame(call, reply_becomes, call.reply)
            call.reply = None
        if role is not None:
            self._keep_frame(call, role, observation)
        call.last_activity = observation.time
        if self._extra_frames > MAX_EXTRA_FRAMES:
            self._latest_overfull = max(self._latest_overfull, self._latest_evicted, call.number)
            self._latest_evicted = self._latest_overfull
            self._serials.release_all(call)

    # requests

    def _add_after_strays(
        self, strays: Sequence[StrayReply], observation: FrameObservation, frame: Frame, number: int
    ) -> bool:
        """Add a request, then add each stray reply in `strays` that belongs to the request's call."""
        is_new = self.add_request(observation, frame, number)
        call = self._by_serial.get(frame.serial)
        if call is not None:  # not evicted
            self._unseen_requests.assign(strays, call, frame.reserved)
        return is_new

    def _start_call(self, observation: FrameObservation, frame: Frame, number: int) -> None:
        newest = self._newest_call
        if newest is not None and newest.state is _ANSWERED:
            if observation.time - newest.last_activity < self._crossing.considered_below_ns:
                self._crossing.add_answered_call(newest, observation)
        elif newest is not None and newest.state in AWAITING_REPLY:
            if observation.time - waits_since(newest) >= SHORTEST_TIMEOUT_NS:
                newest.abandoned_at = observation.time
                newest.state = TRANSITIONS[newest.state, CallEvent.NEXT_CALL].state
            elif frame.reserved in (0, frame.serial):  # only a first attempt shows when its call began
                self._crossing.ignore_reactions()
        call = Call(number, self._conversation, self._kind_of(frame), observation, self._reserved_usage)
        if frame.code == SERVICE_START:
            self._session_call = number
        if not self._latest_answered:
            self._requests_only.add_call(call)
        if self._is_tcp:
            self._serials.queue_reused(frame.serial)
        self._by_serial[frame.serial] = self._newest_call = call
        self.open_calls.append(call)
        call.memory_bytes = size = len(frame.raw)
        self._budget.held += size

    def _add_later_attempt(self, observation: FrameObservation, frame: Frame, number: int) -> bool:
        """Add a retry on UDP. If the first attempt was not captured, start a new call and return True."""
        serial, reserved = frame.serial, frame.reserved
        origin, newest = self._by_serial.get(reserved), None
        if origin is None:
            convention = self._reserved_usage.convention
            origin, newest = find_retried_call(self._newest_call, self.open_calls, frame, convention)
        if origin is not None and origin.request.item.raw[9:] == frame.raw[9:]:
            self._add_retry(origin, observation, frame)
            return False
        self._start_call(observation, frame, number)
        # the first attempt was not captured, but further retries may name its serial
        call = self._by_serial[reserved] = self._by_serial[serial]
        self._serials.add_skipped(reserved, serial, call)
        if newest is not None:
            newest.may_continue_in = call
        return True

    def _add_to_prior(self, prior: Call, observation: FrameObservation, frame: Frame) -> bool:
        """Add a request to the call `prior` if the request belongs to `prior`; return True if so. The request
        may be a copy of an attempt, or a first attempt that a retry overtook.
        """
        if self._is_tcp:
            return False
        starts_anew = frame.code == SERVICE_START and prior is not self._newest_call
        copies_within = SHORTEST_TIMEOUT_NS if starts_anew else COPIES_WITHIN_NS
        is_of_session = prior.number >= self._session_call
        sent = self._frame_indexes[prior].sent_at.get(frame.raw) if is_of_session else None
        if sent is not None and observation.time - sent <= copies_within:
            self._apply(prior, copy_event(observation.time, sent), observation)
            return True
        first = prior.request.item
        if (
            prior.first_attempt_seen
            or first.reserved != frame.serial
            or frame.reserved not in (0, frame.serial)
            or first.raw[9:] != frame.raw[9:]
        ):
            return False
        self._learn_from_first(frame.serial, frame.reserved)
        self._apply(prior, CallEvent.FIRST_ATTEMPT, observation)
        return True

    def _add_retry(self, call: Call, observation: FrameObservation, frame: Frame) -> None:
        last = call.last_attempt.item
        self._by_serial[frame.serial] = call
        if is_later(last.serial, frame.serial):
            event = CallEvent.OVERTAKEN_RETRY
            call.unseen_serials = tuple(serial for serial in call.unseen_serials if serial != frame.serial)
        else:
            event = CallEvent.LATER_RETRY
            if call is self._newest_call:
                event = CallEvent.RETRY
                self._serials.add_skipped(last.serial, frame.serial, call)
            self._learn_from_retry(call, frame)
            call.last_attempt = observation
        self._apply(call, event, observation)

    def _learn_from_retry(self, call: Call, frame: Frame) -> None:
        first = call.request.item
        origin = first.serial if call.first_attempt_seen else first.reserved
        self._reserved_usage = self._reserved_usage.after_retry(
            origin, call.latest_serial, frame.reserved, self._first_reserved == 0
        )

    def _replace_request(self, call: Call, observation: FrameObservation) -> None:
        """Set `Call.request` to a first attempt that arrived after a retry."""
        call.other_frames = [CallFrame(FrameRole.RETRY, call.request), *call.other_frames]
        call.request = observation
        self._count_further_frame(call, FrameRole.REQUEST, observation)

    def _learn_from_first(self, serial: int, reserved: int) -> None:
        if not self._is_tcp:
            if serial:  # a first attempt with serial 0 has 0 in the reserved field under every convention
                self._reserved_usage = self._reserved_usage.after_first_attempt(reserved)
                self._first_reserved = int(reserved != 0)
            return
        self._reserved_usage = self._reserved_usage.after_first_on_tcp(serial, reserved)
        if not reserved == serial == 1:
            self._first_reserved = reserved

    def _keep_frame(self, call: Call, role: FrameRole, observation: FrameObservation) -> None:
        call.add_frame(role, observation)
        self._count_further_frame(call, role, observation)

    def _count_further_frame(self, call: Call, role: FrameRole, observation: FrameObservation) -> None:
        self._extra_frames += 1
        size = len(observation.item.raw) + FRAME_COST
        call.memory_bytes += size
        self._budget.held += size
        if call in self._frame_indexes:
            self._frame_indexes[call].add_frame(role, observation)

    # replies

    def _learn_from_reply(self, call: Call, reply: Frame) -> None:
        reserved = self._frame_indexes[call].reserved_by_serial.get(reply.serial)
        if reserved is not None:
            self._reserved_usage = self._reserved_usage.after_reply(reserved, reply.reserved)

    def _accept_reply(self, call: Call, observation: FrameObservation, frame: Frame) -> None:
        call.reply = observation
        call.last_activity = observation.time
        size = len(frame.raw)
        call.memory_bytes += size
        self._budget.held += size
        if call in self._frame_indexes:
            self._frame_indexes[call].add_frame(FrameRole.REPLY, observation)
        if frame.code == E_BUSY:
            self._response_seen = True
        elif call.number > self._latest_answered:
            self._latest_answered = call.number
            if self.open_calls[0] is not call:
                self._answered_early.append((call.number, observation.time))

    def _add_further_reply(self, call: Call, observation: FrameObservation, frame: Frame) -> None:
        is_latest = frame.serial == call.last_attempt.item.serial
        event = CallEvent.REPLY if is_latest else CallEvent.EARLIER_REPLY
        if frame.code == S_EXECUTING:  # identical notices are no copies
            event = CallEvent.NOTICE
        elif (earlier := self._frame_indexes[call].received_at.get(frame.raw)) is not None:
            event = copy_event(observation.time, earlier)
        self._apply(call, event, observation)

    def _stray_reply(self, observation: FrameObservation, call_number: int | None) -> StrayReply:
        stray = StrayReply(
            observation,
            call_number,
            may_answer_evicted=(1 if call_number is None else call_number) <= self._latest_evicted,
        )
        self._unseen_requests.add_stray_reply(stray, self._newest_call)
        return stray

    # settling

    def _finish_call(self, call: Call, event: CallEvent) -> Call:
        if call.state is _ANSWERED and not call.other_frames:  # nearly all calls
            call.state = _SETTLED
        else:
            self._settle_irregular(call, event)
        overtaking = self._answered_early
        while overtaking and overtaking[0][0] <= call.number:
            overtaking.popleft()
        call.reserved_usage = self._reserved_usage
        size = call.memory_bytes
        self._budget.held -= size
        if size > LARGE_CALL and call is self._newest_call:
            self._newest_call = None
        if call.kind.function_id in OPENERS:
            self._handles.add_call(call)
        if self._frame_indexes:
            self._frame_indexes.pop(call, None)
        frame = call.request.item
        serial = frame.serial
        if call.other_frames or frame.reserved not in (0, serial):
            self._crossing.settle(call)
            self._extra_frames -= len(call.other_frames)
            self._serials.release_all(call)
        else:
            self._release_serial(serial, call)
        return call

    def _settle_irregular(self, call: Call, event: CallEvent) -> None:
        """Settle a call that has no reply, or has more frames than one request and one reply."""
        gave_up_at = self._timeouts.add_call(call) if call.other_frames and not self._is_tcp else 0
        if gave_up_at and call.state is _ANSWERED and call.reply is not None:
            call.abandoned_at, call.gave_up_inferred = gave_up_at, True
            self._apply(call, CallEvent.OVERDUE_REPLY, call.reply)
        else:
            call.state = _SETTLED if call.state is _ANSWERED else TRANSITIONS[call.state, event].state
        if call.may_continue_in is not None:
            settle_continuation(call, self._reserved_usage.convention, self._latest_answered)
        if not self._latest_answered and not self._response_seen:
            call.reply_missed = self._requests_only.is_proven
        elif call.reply is None and not self._is_tcp:
            call.reply_missed |= self._handles.prove_reply(call, self.open_calls)
