"""Pair the frames of one conversation into calls. `pairing_states` has the table of how a frame changes the
state of its call.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS, ResultKind
from bcapscope.protocol.tables.hresult import E_BUSY, S_EXECUTING, is_failure
from bcapscope.traffic.call import Call, CallFrame, CallState, FrameObservation, FrameRole, StrayReply
from bcapscope.traffic.call_kind import CallKinds
from bcapscope.traffic.frame_index import FrameIndex, is_captured_again
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.pairing_states import TRANSITIONS, CallEvent
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedFieldUsage
from bcapscope.traffic.serial_table import SerialTable

SERVICE_START = 1

SHORTEST_TIMEOUT_NS = 2_000_000
"""Shortest timeout of a client, ns (DENSO Wave 2009, slvMove). A client that begins a new call sooner after
the previous request does not wait for replies, and so may still accept the reply to the previous request."""

COPIES_WITHIN_NS = 100_000_000
"""Maximum time in ns within which copies and reordered frames arrive: factory networks delay a frame by
milliseconds. No client restarts on the same port this fast without a Service_Start."""

RETRY_WITHIN_NS = 5_000_000_000
"""Maximum time in ns from a captured reply to a retry of its request. No client waits longer before a retry
(3 s in DENSO's ROS 2 driver, 1 s in DENSO Wave 2009)."""

LATE_WITHIN_NS = 1_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call, if the controller has answered
a later call. A reply after this time is a stray reply that names its call."""

BUSY_WITHIN_NS = 30_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call, if the controller has not
answered a later call. The controller may still be executing the call, because controllers answer in order."""

EXECUTION_NS = 180_000_000_000
"""Maximum time in ns without a frame of a call, if no later call was answered: the server's InvokeTimeout,
after which the server never answers (orin_bcap C/src/bCAPServer/bcap_server.c)."""

MAX_EXTRA_FRAMES = 65536
"""Maximum number of retries, notices and further replies of a conversation's open calls, about 30 MB. The
call that exceeds the limit is evicted with all earlier calls, and its further frames start another call. The
older C client retries without end (start-jsk/denso b-Cap.c), and so reaches the limit within 20 minutes at
one retry every 20 ms."""

_FRAME_COST = 512  # bytes of overhead per frame
# Size in bytes above which a settled call does not stay in memory as the newest call.
_LARGE_CALL = 64 * 1024

_OPENERS = frozenset((SERVICE_START, *(f.id for f in FUNCTIONS.values() if f.result is ResultKind.HANDLE)))
_WAITING, _ANSWERED, _SETTLED = CallState.WAITING, CallState.ANSWERED, CallState.SETTLED
_EXPIRY, _EVICTION = CallEvent.EXPIRY, CallEvent.EVICTION
_AWAITING_REPLY = frozenset(state for state, event in TRANSITIONS if event is CallEvent.NEXT_CALL)


class ConversationPairing:
    """Pairs the frames of one conversation, and yields its completed calls in starting order.

    Attributes:
        memory_bytes: Size in bytes of the frames of all open calls, with overhead.
    """

    def __init__(
        self,
        conversation: Conversation,
        latest_evicted: int = 0,
        budget: ByteBudget | None = None,
        kinds: CallKinds | None = None,
    ) -> None:
        """Start without calls.

        Args:
            latest_evicted: Call number of the latest evicted call that may belong to this conversation; 0 if
                there is none.
            budget: Counts the bytes of the open calls of all conversations.
            kinds: Finds the call kinds of requests, for all conversations.
        """
        self.open_calls: deque[Call] = deque()
        self.memory_bytes = 0
        self._budget = budget or ByteBudget()
        self._conversation = conversation
        self._latest_evicted = latest_evicted
        self._kind_of = (kinds or CallKinds()).kind_of
        self._is_tcp = conversation.transport is Transport.TCP
        self._reserved_usage = ReservedFieldUsage()
        # reserved field of the latest first attempt; on UDP only 0 (zero) or 1 (not zero)
        self._first_reserved = -1
        self._serials = SerialTable()
        self._by_serial = self._serials.open_calls
        self._newest_call: Call | None = None
        self._frame_indexes: dict[Call, FrameIndex] = {}  # made on the first lookup in an open call
        self._extra_frames = 0  # number of frames in `other_frames` of all open calls
        self._latest_overfull = 0  # number of the latest call that exceeded MAX_EXTRA_FRAMES
        self._session_call = 0  # number of the latest Service_Start call
        self._latest_answered = 0  # highest number of an answered call
        self._answered_early: deque[tuple[int, int]] = (
            deque()
        )  # number and time of calls answered before older ones
        self._last_handle = 0  # the last handle returned in this session
        self._reused_serials = self._serials.reused
        self._release_serial = self._serials.release

    def add_request(self, observation: FrameObservation, frame: Frame, number: int) -> bool:
        """Add a request. Return whether the request starts a new call, which then gets the number
        `number`."""
        serial, reserved = frame.serial, frame.reserved
        prior = self._by_serial.get(serial)
        if prior is not None and self._add_to_prior(prior, observation, frame):
            return False
        if reserved and reserved != serial and not self._is_tcp:
            origin = self._by_serial.get(reserved)
            if origin is not None and origin.request.item.raw[9:] == frame.raw[9:]:
                self._add_retry(origin, observation, frame)
                return False
            self._start_call(observation, frame, number)
            # the first attempt was not captured, and further retries can name its serial
            self._by_serial[reserved] = self._by_serial[serial]
            return True
        if not reserved and 0 in self._by_serial and self._add_retry_of_serial_zero(observation, frame):
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

    def add_undelivered_reply(self, observation: FrameObservation, frame: Frame) -> None:
        """Add a reply or notice that the controller sent, and that did not reach the client's side."""
        call = self._by_serial.get(frame.serial)
        if call is not None:
            is_notice = frame.code == S_EXECUTING
            self._apply(call, CallEvent.NOTICE if is_notice else CallEvent.UNDELIVERED_REPLY, observation)

    def add_own_request(self, observation: FrameObservation, frame: Frame) -> None:
        """Add a request that a proxy sent on its own. Only a copy of a client's request belongs to a call."""
        prior = self._by_serial.get(frame.serial)
        if prior is not None:
            self._add_to_prior(prior, observation, frame)

    def pop_settled(self, now: int) -> Iterator[Call]:
        """Yield the calls to which no further frame can belong after the time `now`."""
        waiting = self.open_calls
        if waiting and waiting[0].number <= self._latest_overfull:
            yield from self.evict_oldest(sum(call.number <= self._latest_overfull for call in waiting))
        while waiting:
            call = waiting[0]
            if self._settles_at(call) > now:
                break
            call.no_reply_expected = not call.abandoned_at
            yield self._finish_call(waiting.popleft(), _EXPIRY)

    def evict_oldest(self, count: int) -> Iterator[Call]:
        """Yield the `count` oldest open calls, even if further frames may belong to them."""
        for _ in range(min(count, len(self.open_calls))):
            call = self.open_calls.popleft()
            event = _EXPIRY if self._is_past_late_window(call) else _EVICTION
            self._latest_evicted = max(self._latest_evicted, call.number)
            yield self._finish_call(call, event)

    def close(self) -> Iterator[Call]:
        """Yield all open calls, because the traffic of the conversation has ended."""
        self._mark_unanswerable()
        while self.open_calls:
            call = self.open_calls.popleft()
            is_overfull = call.number <= self._latest_overfull
            yield self._finish_call(call, _EVICTION if is_overfull else _EXPIRY)

    def _mark_unanswerable(self) -> None:
        """Mark the open calls that could no longer be answered when the traffic ended. A later call that was
        answered shows this, because controllers answer in order and the network reorders replies only within
        a short time.
        """
        closing = self._conversation.connection_end
        over = closing is not None and closing.ends_replies
        end = max((call.last_activity for call in self.open_calls), default=0)
        overtaken = end + 1 if self._is_tcp else end - COPIES_WITHIN_NS
        answered = overtaken  # time of the earliest reply to a later call, or else `overtaken`
        for call in reversed(self.open_calls):
            call.no_reply_expected = over or answered < overtaken
            if call.reply is not None and call.reply.item.code != E_BUSY:
                answered = min(answered, call.reply.time)

    def _apply(self, call: Call, event: CallEvent, observation: FrameObservation) -> None:
        """Add a frame to a call, and change the state of the call according to `TRANSITIONS`."""
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
            self._latest_overfull = self._latest_evicted = max(
                self._latest_overfull, self._latest_evicted, call.number
            )
            self._serials.release_all(call)

    # requests

    def _start_call(self, observation: FrameObservation, frame: Frame, number: int) -> None:
        newest = self._newest_call
        if newest is not None and newest.state is not _ANSWERED and newest.state in _AWAITING_REPLY:
            since = max((newest.last_attempt.time, *(notice.time for notice in newest.notices)))
            if observation.time - since >= SHORTEST_TIMEOUT_NS:
                newest.abandoned_at = observation.time
                newest.state = TRANSITIONS[newest.state, CallEvent.NEXT_CALL].state
        call = Call(number, self._conversation, self._kind_of(frame), observation, self._reserved_usage)
        if frame.code == SERVICE_START:
            self._session_call = number
        if self._is_tcp:
            self._serials.queue_reused(frame.serial)
        self._by_serial[frame.serial] = self._newest_call = call
        self.open_calls.append(call)
        self._count_memory(call, len(frame.raw))

    def _add_to_prior(self, prior: Call, observation: FrameObservation, frame: Frame) -> bool:
        """Add a copy of a frame of `prior`, or the first attempt if a retry overtook it. Return whether the
        frame was added."""
        if self._is_tcp:
            return False
        starts_anew = prior.number < self._session_call or (
            frame.code == SERVICE_START and prior is not self._newest_call
        )
        sent = None if starts_anew else self._frame_index_of(prior).sent_at.get(frame.raw)
        if sent is not None and observation.time - sent <= COPIES_WITHIN_NS:
            self._add_copy(prior, observation, sent)
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

    def _add_retry_of_serial_zero(self, observation: FrameObservation, frame: Frame) -> bool:
        """Add a retry of a call with serial 0.

        The reserved field of a retry of serial 0 looks like that of a first attempt.

        Old clients may use serial 0 (start-jsk/denso b-Cap.c). The frame is considered a retry if it repeats
        the newest call, and this call is still unanswered.
        """
        call = self._by_serial[0]
        if (
            call is not self._newest_call
            or call.reply is not None
            or call.request.item.raw[9:] != frame.raw[9:]
        ):
            return False
        self._add_retry(call, observation, frame)
        return True

    def _add_retry(self, call: Call, observation: FrameObservation, frame: Frame) -> None:
        first, last = call.request.item, call.last_attempt.item
        origin = first.serial if call.first_attempt_seen else first.reserved
        self._reserved_usage = self._reserved_usage.after_retry(
            origin, last.serial, frame.reserved, self._first_reserved == 0
        )
        self._by_serial[frame.serial] = call
        if (frame.serial - last.serial) & 0xFFFF >= 0x8000:
            event = CallEvent.OVERTAKEN_RETRY
        else:
            event = CallEvent.RETRY if call is self._newest_call else CallEvent.LATER_RETRY
            call.last_attempt = observation
        self._apply(call, event, observation)

    def _replace_request(self, call: Call, observation: FrameObservation) -> None:
        """Make the first attempt the request of the call, in place of the retry that overtook it."""
        call.other_frames = [CallFrame(FrameRole.RETRY, call.request), *call.other_frames]
        call.request = observation
        self._extra_frames += 1
        self._count_memory(call, len(observation.item.raw) + _FRAME_COST)
        self._frame_index_of(call).add_frame(FrameRole.REQUEST, observation)

    def _learn_from_first(self, serial: int, reserved: int) -> None:
        if not self._is_tcp:
            if serial:  # with serial 0, the value 0 in the reserved field may be the frame's own serial
                self._reserved_usage = self._reserved_usage.after_first_attempt(reserved)
                self._first_reserved = int(reserved != 0)
            return
        self._reserved_usage = self._reserved_usage.after_first_on_tcp(serial, reserved)
        if not reserved == serial == 1:
            self._first_reserved = reserved

    def _keep_frame(self, call: Call, role: FrameRole, observation: FrameObservation) -> None:
        call.add_frame(role, observation)
        self._extra_frames += 1
        self._count_memory(call, len(observation.item.raw) + _FRAME_COST)
        if call in self._frame_indexes:
            self._frame_indexes[call].add_frame(role, observation)

    def _count_memory(self, call: Call, size: int) -> None:
        call.memory_bytes += size
        self.memory_bytes += size
        self._budget.held += size

    def _frame_index_of(self, call: Call) -> FrameIndex:
        index = self._frame_indexes.get(call)
        if index is None:
            index = self._frame_indexes[call] = FrameIndex(call)
        return index

    # replies

    def _learn_from_reply(self, call: Call, reply: Frame) -> None:
        reserved = self._frame_index_of(call).reserved_by_serial.get(reply.serial)
        if reserved is not None:
            self._reserved_usage = self._reserved_usage.after_reply(reserved, reply.reserved)

    def _accept_reply(self, call: Call, observation: FrameObservation, frame: Frame) -> None:
        call.reply = observation
        call.last_activity = observation.time
        self._count_memory(call, len(frame.raw))
        if self._frame_indexes and call in self._frame_indexes:
            self._frame_indexes[call].add_frame(FrameRole.REPLY, observation)
        if call.number > self._latest_answered and frame.code != E_BUSY:
            self._latest_answered = call.number
            if self.open_calls[0] is not call:
                self._answered_early.append((call.number, observation.time))

    def _add_further_reply(self, call: Call, observation: FrameObservation, frame: Frame) -> None:
        if frame.code == S_EXECUTING:  # identical notices are no copies
            self._apply(call, CallEvent.NOTICE, observation)
            return
        earlier = self._frame_index_of(call).received_at.get(frame.raw)
        if earlier is not None:
            self._add_copy(call, observation, earlier)
            return
        is_latest = frame.serial == call.last_attempt.item.serial
        self._apply(call, CallEvent.REPLY if is_latest else CallEvent.EARLIER_REPLY, observation)

    def _add_copy(self, call: Call, observation: FrameObservation, earlier: int) -> None:
        is_same_packet = is_captured_again(observation.time, earlier)
        self._apply(call, CallEvent.CAPTURED_AGAIN if is_same_packet else CallEvent.COPY, observation)

    def _stray_reply(self, observation: FrameObservation, call_number: int | None) -> StrayReply:
        return StrayReply(
            observation,
            call_number,
            may_answer_evicted=(1 if call_number is None else call_number) <= self._latest_evicted,
        )

    # settling

    def _settles_at(self, call: Call) -> int:
        quiet = call.last_activity
        if call.reply is not None:
            if self._is_tcp:
                return quiet
            return quiet + (RETRY_WITHIN_NS if call is self._newest_call else COPIES_WITHIN_NS)
        if call.abandoned_at:
            since = max(quiet, call.abandoned_at)
            if call.number >= self._latest_answered:
                return since + BUSY_WITHIN_NS
            return max(since + LATE_WITHIN_NS, self._answered_early[0][1] + COPIES_WITHIN_NS)
        return quiet + (LATE_WITHIN_NS if call.number < self._latest_answered else EXECUTION_NS)

    def _is_past_late_window(self, call: Call) -> bool:
        """Return whether the newest call started so long after this call that a reply to this call would be
        late."""
        newest = self._newest_call
        return newest is not None and 0 < call.abandoned_at <= newest.request.time - LATE_WITHIN_NS

    def _finish_call(self, call: Call, event: CallEvent) -> Call:
        call.state = _SETTLED if call.state is _ANSWERED else TRANSITIONS[call.state, event].state
        overtaking = self._answered_early
        while overtaking and overtaking[0][0] <= call.number:
            overtaking.popleft()
        call.reserved_usage = self._reserved_usage
        self.memory_bytes -= call.memory_bytes
        self._budget.held -= call.memory_bytes
        if call.memory_bytes > _LARGE_CALL and call is self._newest_call:
            self._newest_call = None
        if call.kind.function_id in _OPENERS:
            self._count_skipped_handles(call)
        if self._frame_indexes:
            self._frame_indexes.pop(call, None)
        frame = call.request.item
        serial = frame.serial
        if call.other_frames or (frame.reserved and frame.reserved != serial):
            self._extra_frames -= len(call.other_frames)
            self._serials.release_all(call)
        else:
            self._release_serial(serial, call)
        return call

    def _count_skipped_handles(self, call: Call) -> None:
        """Count the handles that the controller gave to unanswered attempts of a call."""
        reply = call.reply
        if call.kind.function_id == SERVICE_START:
            self._last_handle = 0
        if reply is None or is_failure(reply.item.code) or not reply.item.arguments:
            return
        vt, handle, _ = reply.item.arguments[0].variant
        if vt != VT.I4 or not isinstance(handle, int):
            return
        skipped = handle - self._last_handle - 1
        if self._last_handle and 0 < skipped < len(call.attempts):
            call.skipped_handles = skipped
        self._last_handle = handle
