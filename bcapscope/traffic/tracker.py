"""Pair the frames of all conversations into calls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS, CallKinds
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.conversation_pairing import ConversationPairing
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Conversation, Direction, Observation

MAX_OPEN = 8192
"""Maximum number of open calls, about 10 MB. Beyond the limit, the tracker evicts the older half of the open
calls of one conversation: the conversation with the most open calls.
"""

MAX_BYTES = 32 * 1024 * 1024
"""Maximum size in bytes of all frames of open calls, with overhead. Beyond the limit, the tracker evicts the
older half of the open calls of one conversation: the conversation whose open calls take the most memory. A
call with one request and one reply, both of maximum size (see `LARGEST_FRAME`), does not exceed the limit.
"""

SWEEP_NS = 50_000_000  # time between two searches for calls whose waiting time has expired

_REQUEST = Direction.REQUEST


class Tracker:
    """Groups requests, retries, notices and replies into calls, in bounded memory.

    The tracker numbers calls in the order in which they began, and returns the calls of a conversation in
    this order. It returns a call when this call and all earlier calls of the conversation are complete. If
    the memory limits are exceeded, the tracker also returns (evicts) calls that may still get a reply.

    The calls depend only on the observations so far and their times; the tracker reads no clock. A truncated
    capture gives the same calls as the whole capture, except the calls that are open when the capture ends.
    """

    def __init__(self, taken_at: CapturePoint | None = None) -> None:
        self._taken_at = taken_at
        self._pairings: dict[Conversation, ConversationPairing] = {}
        self._current_conversation: Conversation | None = None
        self._pairing: ConversationPairing
        self._budget = ByteBudget(MAX_BYTES)
        self._kinds = CallKinds()
        self._calls_started = 0
        self._calls_settled = 0
        # value of `_calls_started` when the tracker last evicted all calls of one conversation; 0 if never
        self._latest_evicted = 0
        self._results: list[PairingResult] = []
        self._swept_at = 0
        self._next_sweep_at = 0

    @property
    def open_calls(self) -> list[Call]:
        waiting = (call for pairing in self._pairings.values() for call in pairing.open_calls)
        return sorted(waiting, key=attrgetter("number"))

    def observe(self, observation: Observation) -> Sequence[PairingResult]:
        """Add the next observation; return the calls that are now complete, and the stray reply, if any."""
        flow, item, time = observation.flow, observation.item, observation.time
        if time >= self._next_sweep_at or time < self._swept_at:
            self._settle_expired(time)
        if flow.conversation is not self._current_conversation:
            self._select_pairing(flow.conversation)
        if isinstance(item, Frame):
            if flow.direction is _REQUEST:
                if self._pairing.add_request(observation, item, self._calls_started + 1):  # type: ignore[arg-type]  # item is a frame
                    self._calls_started += 1
                    if self._calls_started - self._calls_settled > MAX_OPEN:
                        self._evict_half(lambda pairing: len(pairing.open_calls))
            else:
                stray = self._pairing.add_reply(observation, item)  # type: ignore[arg-type]  # item is a frame
                if stray is not None:
                    self._results.append(stray)
            while self._budget.held > MAX_BYTES:
                self._evict_half(attrgetter("memory_bytes"))
        elif item.missing or any(problem.code == "cut" for problem in item.problems):
            self._pairing.add_gap(flow.direction)
        return self._pop_results() if self._results else ()

    def observe_joined(self, observation: JoinedObservation) -> Sequence[PairingResult]:
        """Add the next observation of a conversation that was captured at two places. A reply that did not
        reach the client's side is lost. A proxy's own requests and the replies to them belong to no call.
        """
        item = observation.item
        is_own = observation.was_made_between and observation.is_request
        is_lost_reply = observation.was_lost_between and not observation.is_request
        if not isinstance(item, Frame) or not (is_own or is_lost_reply):
            return self.observe(observation)
        if observation.flow.conversation is not self._current_conversation:
            self._select_pairing(observation.flow.conversation)
        if is_own:
            self._pairing.add_own_request(observation, item)  # type: ignore[arg-type]  # item is a frame
        else:
            self._pairing.add_undelivered_reply(observation, item)  # type: ignore[arg-type]  # item is a frame
        return self._pop_results() if self._results else ()

    def expire(self, now: int) -> Sequence[PairingResult]:
        """Return the calls to which no frame can belong after the time `now`, ns since 1970."""
        self._settle_expired(now)
        return self._pop_results()

    def close_conversation(self, conversation: Conversation) -> Sequence[PairingResult]:
        """Return the open calls of a conversation that has ended, and drop its data."""
        pairing = self._pairings.pop(conversation, None)
        if conversation is self._current_conversation:
            self._current_conversation = None
        if pairing is not None:
            self._collect(pairing.close(self._swept_at))
        return self._pop_results()

    def close(self) -> Sequence[PairingResult]:
        """Return all open calls in starting order. Call this method when the traffic has ended."""
        rest = [call for pairing in self._pairings.values() for call in pairing.close(self._swept_at)]
        self._calls_settled += len(rest)
        return sorted(rest, key=attrgetter("number"))

    def _select_pairing(self, conversation: Conversation) -> None:
        pairing = self._pairings.pop(conversation, None) or ConversationPairing(
            conversation, self._latest_evicted, self._budget, self._kinds, self._taken_at
        )
        while len(self._pairings) >= MAX_CONVERSATIONS:
            silent = self._pairings.pop(next(iter(self._pairings)))
            if silent.open_calls:
                self._latest_evicted = self._calls_started
                self._collect(silent.evict_oldest(len(silent.open_calls)))
        self._pairings[conversation] = pairing
        self._current_conversation, self._pairing = conversation, pairing

    def _settle_expired(self, now: int) -> None:
        for pairing in self._pairings.values():
            if pairing.open_calls:
                self._collect(pairing.pop_settled(now))
        self._swept_at, self._next_sweep_at = now, now + SWEEP_NS

    def _evict_half(self, size: Callable[[ConversationPairing], int]) -> None:
        largest = max(self._pairings.values(), key=size)
        self._collect(largest.evict_oldest((len(largest.open_calls) + 1) // 2))

    def _collect(self, calls: Iterable[Call]) -> None:
        settled = [*calls]
        self._results += settled
        self._calls_settled += len(settled)

    def _pop_results(self) -> Sequence[PairingResult]:
        due, self._results = self._results, []
        return due
