"""Pairing: observations go in, calls come out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter

from bcapscope.protocol.budget import Budget
from bcapscope.protocol.frame import Frame
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.lane import Lane
from bcapscope.traffic.observation import Conversation, Direction, Observation
from bcapscope.traffic.question import MOST_CONVERSATIONS

MOST_OPEN = 8192
"""Calls that are kept open in all, about 10 MB; when there are more, the older half of the busiest
conversation's is let go. Where four clients send a set point each 2 ms and get no answer, those are older
than a second, after which a reply would be late, so that they count as unanswered."""

MOST_BYTES = 32 * 1024 * 1024
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
        self._lanes: dict[Conversation, Lane] = {}
        self._conversation: Conversation | None = None
        self._lane: Lane
        self._budget = Budget(MOST_BYTES)
        self._started = 0
        self._given_out = 0
        self._let_go = 0  # the latest call that may have been let go together with its conversation
        self._due: list[Settled] = []
        self._swept = 0
        self._sweep_at = 0

    @property
    def open(self) -> list[Exchange]:
        """The calls that have not settled, in the order of their start."""
        waiting = (exchange for lane in self._lanes.values() for exchange in lane.waiting)
        return sorted(waiting, key=lambda exchange: exchange.call)

    def observe(self, observation: Observation) -> Sequence[Settled]:
        """Take in what was seen next; return the calls that settled, and it itself if it is a stray.

        Bytes that are no frame belong to no call.
        """
        flow, item, time = observation.flow, observation.item, observation.time
        if time >= self._sweep_at or time < self._swept:
            self._sweep(time)
        if flow.conversation is not self._conversation:
            self._turn_to(flow.conversation)
        if isinstance(item, Frame):
            if flow.direction is _REQUEST:
                if self._lane.request(observation, item, self._started + 1):  # type: ignore[arg-type]  # item is a frame
                    self._started += 1
                    if self._started - self._given_out > MOST_OPEN:
                        self._make_room()
            else:
                stray = self._lane.reply(observation, item)  # type: ignore[arg-type]  # item is a frame
                if stray is not None:
                    self._due.append(stray)
            while self._budget.is_exceeded:
                self._give_out_half(max(self._lanes.values(), key=attrgetter("weight")))
        return self._take_due() if self._due else ()

    def expire(self, now: int) -> Sequence[Settled]:
        """Return the calls that have settled by `now`, in nanoseconds, though nothing new was seen."""
        self._sweep(now)
        return self._take_due()

    def forget(self, conversation: Conversation) -> Sequence[Settled]:
        """Return the open calls of a conversation that is over, and forget it."""
        lane = self._lanes.pop(conversation, None)
        if conversation is self._conversation:
            self._conversation = None
        if lane is not None:
            self._give_out(lane.close())
        return self._take_due()

    def close(self) -> Sequence[Settled]:
        """Return all calls that are open, in the order of their start; the traffic has ended."""
        rest = [exchange for lane in self._lanes.values() for exchange in lane.close()]
        self._given_out += len(rest)
        return sorted(rest, key=lambda exchange: exchange.call)

    def _turn_to(self, conversation: Conversation) -> None:
        lane = self._lanes.pop(conversation, None) or Lane(conversation, self._let_go, self._budget)
        while len(self._lanes) >= MOST_CONVERSATIONS:
            silent = self._lanes.pop(next(iter(self._lanes)))
            if silent.waiting:
                self._let_go = self._started
                self._give_out(silent.let_go(len(silent.waiting)))
        self._lanes[conversation] = lane
        self._conversation, self._lane = conversation, lane

    def _sweep(self, now: int) -> None:
        for lane in self._lanes.values():
            if lane.waiting:
                self._give_out(lane.settle(now))
        self._swept, self._sweep_at = now, now + SWEEP_NS

    def _make_room(self) -> None:
        self._give_out_half(max(self._lanes.values(), key=lambda lane: len(lane.waiting)))

    def _give_out_half(self, lane: Lane) -> None:
        self._give_out(lane.let_go((len(lane.waiting) + 1) // 2))

    def _give_out(self, exchanges: Iterable[Exchange]) -> None:
        before = len(self._due)
        self._due.extend(exchanges)
        self._given_out += len(self._due) - before

    def _take_due(self) -> Sequence[Settled]:
        due, self._due = self._due, []
        return due
