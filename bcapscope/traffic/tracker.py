"""Pairing: observations go in, calls come out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter

from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.conversation_pairing import ConversationPairing
from bcapscope.traffic.observation import Conversation, Direction, Observation

MAX_OPEN = 8192
"""Calls that are kept open in all, about 10 MB; when there are more, the older half of the busiest
conversation's is let go. Where four clients send a set point each 2 ms and get no answer, those are older
than a second, after which a reply would be late, so that they count as unanswered."""

MAX_BYTES = 32 * 1024 * 1024
"""Bytes of all frames of open calls, with what keeping them costs; beyond that, the conversation that holds
most evicts the older half of its calls. The limit fits one call whose request and reply have the largest
size."""

SWEEP_NS = 50_000_000
"""Time of the traffic between two looks for calls that have settled: too short for people to notice."""

_REQUEST = Direction.REQUEST


class Tracker:
    """Pairs requests, retries, notices and replies, live or recorded, in memory that is bounded.

    Calls are numbered in the order in which they start. Within a conversation they are given out in that
    order, each as soon as nothing more is to be expected for it and those before it; one conversation never
    waits for another. What is given out depends on the observations so far alone: a capture that is cut
    short gives the same calls as the whole one, up to those that are still open where it ends. Where more is
    open than is kept, calls are let go: given out as not followed any further, which is no word on whether
    they were answered.

    Time is that of the observations; nothing else decides when a call settles. Observations come in the
    order in which they were seen, and in that of their times as far as a capture keeps it.
    """

    def __init__(self) -> None:
        self._pairings: dict[Conversation, ConversationPairing] = {}
        self._current_conversation: Conversation | None = None
        self._pairing: ConversationPairing
        self._budget = ByteBudget(MAX_BYTES)
        self._calls_started = 0
        self._calls_settled = 0
        self._latest_evicted = 0  # the latest call that may have been let go together with its conversation
        self._results: list[PairingResult] = []
        self._swept_at = 0
        self._next_sweep_at = 0

    @property
    def open_calls(self) -> list[Call]:
        """The calls that have not settled, in the order of their start."""
        waiting = (exchange for lane in self._pairings.values() for exchange in lane.open_calls)
        return sorted(waiting, key=lambda exchange: exchange.number)

    def observe(self, observation: Observation) -> Sequence[PairingResult]:
        """Take in what was seen next; return the calls that settled, and it itself if it is a stray.

        Bytes that are no frame belong to no call.
        """
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
                        self._evict_from_longest()
            else:
                stray = self._pairing.add_reply(observation, item)  # type: ignore[arg-type]  # item is a frame
                if stray is not None:
                    self._results.append(stray)
            while self._budget.is_exceeded:
                self._evict_half(max(self._pairings.values(), key=attrgetter("memory_bytes")))
        return self._pop_results() if self._results else ()

    def expire(self, now: int) -> Sequence[PairingResult]:
        """Return the calls that have settled by `now`, in nanoseconds, though nothing new was seen."""
        self._settle_expired(now)
        return self._pop_results()

    def close_conversation(self, conversation: Conversation) -> Sequence[PairingResult]:
        """Return the open calls of a conversation that is over, and forget it."""
        lane = self._pairings.pop(conversation, None)
        if conversation is self._current_conversation:
            self._current_conversation = None
        if lane is not None:
            self._collect(lane.close())
        return self._pop_results()

    def close(self) -> Sequence[PairingResult]:
        """Return all calls that are open, in the order of their start; the traffic has ended."""
        rest = [exchange for lane in self._pairings.values() for exchange in lane.close()]
        self._calls_settled += len(rest)
        return sorted(rest, key=lambda exchange: exchange.number)

    def _select_pairing(self, conversation: Conversation) -> None:
        lane = self._pairings.pop(conversation, None) or ConversationPairing(
            conversation, self._latest_evicted, self._budget
        )
        while len(self._pairings) >= MAX_CONVERSATIONS:
            silent = self._pairings.pop(next(iter(self._pairings)))
            if silent.open_calls:
                self._latest_evicted = self._calls_started
                self._collect(silent.evict_oldest(len(silent.open_calls)))
        self._pairings[conversation] = lane
        self._current_conversation, self._pairing = conversation, lane

    def _settle_expired(self, now: int) -> None:
        for lane in self._pairings.values():
            if lane.open_calls:
                self._collect(lane.pop_settled(now))
        self._swept_at, self._next_sweep_at = now, now + SWEEP_NS

    def _evict_from_longest(self) -> None:
        self._evict_half(max(self._pairings.values(), key=lambda lane: len(lane.open_calls)))

    def _evict_half(self, pairing: ConversationPairing) -> None:
        self._collect(pairing.evict_oldest((len(pairing.open_calls) + 1) // 2))

    def _collect(self, calls: Iterable[Call]) -> None:
        before = len(self._results)
        self._results.extend(calls)
        self._calls_settled += len(self._results) - before

    def _pop_results(self) -> Sequence[PairingResult]:
        due, self._results = self._results, []
        return due
