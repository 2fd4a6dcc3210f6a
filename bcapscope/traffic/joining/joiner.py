"""Join the conversations that several places captured, and give all observations out in order of time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations

from bcapscope.traffic.joining.captured_twins import CapturedTwins, CaptureSide
from bcapscope.traffic.joining.delivery_queue import DeliveryQueue
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import JOIN_WITHIN_NS, NO_COMMENTS, PlaceMerger
from bcapscope.traffic.joining.twin_recognition import (
    ENOUGH_CALLS,
    FEWEST_CALLS,
    NestedCalls,
    may_be_twins,
    nested_calls,
)
from bcapscope.traffic.observation import Conversation, Direction, Flow, Observation

HELD_NS = 1_000_000_000
"""Maximum time in ns for which the traffic of a new conversation is held until its twin is known."""

HELD_FRAMES = 512
"""Maximum number of frames of a new conversation that are held until its twin is known."""

OWN_CALLS = 2
"""Number of answered calls after which a conversation has no twin, if no other conversation has the same
requests. A proxy forwards a request before its reply comes."""

MAX_CONVERSATIONS = 4096
"""Maximum number of conversations that are remembered. Beyond this limit, all are forgotten, and recognised
anew."""

MAX_JOINED = 256
"""Maximum number of joined conversations. Beyond this limit, the first one is no longer joined."""

MAX_SENDERS = 16
"""Maximum number of conversations that are compared because they have the same request."""

MAX_REQUESTS = 65536
"""Maximum number of requests of new conversations that are remembered to compare them."""

_REQUEST = Direction.REQUEST


class _NewConversation:
    """A conversation whose twin is not known yet, with its traffic so far."""

    def __init__(self, first: Observation) -> None:
        self.conversation = first.flow.conversation
        self.began = first.time
        self.held: list[Observation] = []
        self.suspects: dict[Conversation, None] = {}
        self._open: set[int] = set()
        self.answered = 0

    def add(self, observation: Observation) -> None:
        self.held.append(observation)
        serial = getattr(observation.item, "serial", -1)
        if observation.flow.direction is _REQUEST:
            self._open.add(serial)
        elif serial in self._open:
            self._open.discard(serial)
            self.answered += 1


class Joiner:
    """Joins conversations that are the two legs of one conversation through a proxy.

    A new conversation is held until it is known whether it has a twin: at most `HELD_NS`. The observations of
    joined conversations come out as `JoinedObservation`, all others unchanged.

    Attributes:
        passing: Flows whose observations need not be added, because nothing waits and they have no twin.
    """

    def __init__(
        self, comments: Mapping[int, tuple[str, ...]] = NO_COMMENTS, only: CapturePlace | None = None
    ) -> None:
        """Start without conversations.

        Args:
            comments: Comments on the latest packets, by packet number.
            only: CapturePlace whose observations come out, instead of joined observations; None to join.
                Conversations without a twin always come out.
        """
        self.passing: set[Flow] = set()
        self._comments = comments
        self._only = only
        self._hidden: set[Conversation] = set()
        self._single_flows: set[Flow] = set()
        self._single: set[Conversation] = set()
        self._new: dict[Conversation, _NewConversation] = {}
        self._senders: dict[bytes, dict[Conversation, None]] = {}
        self._mergers: dict[Conversation, tuple[PlaceMerger, CapturePlace]] = {}
        self._captured_twins: dict[CapturedTwins, PlaceMerger] = {}
        self._queue = DeliveryQueue()
        self._now = 0

    def add(self, observation: Observation) -> Sequence[Observation]:
        """Add the next observation; return the observations that are due, in order of time."""
        time = observation.time
        due: list[Observation] = []
        if time < self._now - JOIN_WITHIN_NS:  # the clock of the capture was set back
            due = self.close()
            self._now = time
        self._now = max(self._now, time)
        flow = observation.flow
        known = self._mergers.get(flow.conversation)
        if known is not None:
            merger, place = known
            merger.add(observation, place)
        elif flow.conversation in self._single:
            self._single_flows.add(flow)
            self._queue.add(observation)
        elif flow.conversation not in self._hidden:
            self._add_new(observation)
        return [*due, *self._pop_due()]

    @property
    def own_requests(self) -> int:
        """Number of requests that proxies made on their own, such as to close a session."""
        return sum(merger.own_requests for merger in self._distinct_mergers())

    def expire(self, now: int) -> Sequence[Observation]:
        """Return the observations that are due at the time `now`, ns since 1970, without a new one."""
        self._now = max(self._now, now)
        return self._pop_due()

    def close(self) -> list[Observation]:
        """Return all observations that are held, because the traffic has ended."""
        while self._new:
            self._decide(next(iter(self._new.values())), FEWEST_CALLS)
        for merger in self._distinct_mergers():
            merger.close()
        self._update_passing()
        return self._queue.pop_all()

    def _add_captured_twin(self, observation: Observation, side: CaptureSide) -> None:
        """Add the first observation of a conversation that two captures hold."""
        conversation, twins = observation.flow.conversation, side.twins
        if self._only is not None:
            if side.place is self._only:
                self._single.add(conversation)
                self._queue.add(observation)
            else:
                self._hidden.add(conversation)
            return
        merger = self._captured_twins.get(twins)
        if merger is None:
            merger = self._captured_twins[twins] = PlaceMerger(
                conversation,
                self._queue.add,
                is_relayed=twins.is_relayed,
                coverage=twins.coverage,
                clock_error=twins.clock_error,
                comments=self._comments,
            )
        elif twins.is_relayed and merger.conversation.controller_leg is None:
            merger.conversation.controller_leg = conversation
        self.passing = set()
        self._mergers[conversation] = merger, side.place
        merger.add(observation, side.place)

    def _add_new(self, observation: Observation) -> None:
        conversation = observation.flow.conversation
        if conversation.capture_side is not None:
            self._add_captured_twin(observation, conversation.capture_side)
            return
        new = self._new.get(conversation)
        if new is None:
            self.passing = set()
            new = self._new[conversation] = _NewConversation(observation)
        new.add(observation)
        if observation.flow.direction is _REQUEST:
            self._find_suspect(new, observation)
        if new.answered >= OWN_CALLS and not new.suspects:
            self._release(new)
        elif new.answered >= ENOUGH_CALLS and new.answered % ENOUGH_CALLS == 0:
            self._decide_if_proved(new)
        if len(new.held) >= HELD_FRAMES and conversation in self._new:
            self._decide(new, FEWEST_CALLS)

    def _find_suspect(self, new: _NewConversation, request: Observation) -> None:
        """Note the other new conversations that have the same request."""
        senders = self._senders.setdefault(request.item.raw, {})
        if new.conversation in senders or len(senders) >= MAX_SENDERS:
            return
        for sender in senders:
            if sender in self._new and may_be_twins(sender, new.conversation):
                new.suspects[sender] = None
                self._new[sender].suspects[new.conversation] = None
        senders[new.conversation] = None
        if len(self._senders) > MAX_REQUESTS:
            self._senders.clear()

    def _decide_if_proved(self, new: _NewConversation) -> None:
        if self._best_twins(new, ENOUGH_CALLS) is not None:
            self._decide(new, ENOUGH_CALLS)

    def _decide(self, new: _NewConversation, fewest: int) -> None:
        """Join a conversation with its twin, or pass it on alone."""
        twins = self._best_twins(new, fewest)
        if twins is None:
            self._release(new)
            return
        client_side, controller_side = twins
        if self._only is not None:
            self._hidden.add(twins[1 - self._only].conversation)
            self._drop_new(twins[1 - self._only].conversation)
            self._release(twins[self._only])
            return
        conversation = client_side.conversation
        conversation.controller_leg = controller_side.conversation
        if len(self._mergers) >= 2 * MAX_JOINED:
            self._stop_joining(next(iter(self._mergers.values()))[0])
        merger = PlaceMerger(conversation, self._queue.add, comments=self._comments)
        places: dict[Conversation, CapturePlace] = {}
        for leg, place in zip((conversation, controller_side.conversation), CapturePlace, strict=True):
            self._mergers[leg] = merger, place
            places[leg] = place
            self._drop_new(leg)
        for each in sorted((*client_side.held, *controller_side.held), key=lambda seen: seen.number):
            merger.add(each, places[each.flow.conversation])

    def _stop_joining(self, merger: PlaceMerger) -> None:
        merger.close()
        for conversation in [each for each, (of, _) in self._mergers.items() if of is merger]:
            del self._mergers[conversation]

    def _best_twins(
        self, new: _NewConversation, fewest: int
    ) -> tuple[_NewConversation, _NewConversation] | None:
        """Return the pair of a conversation and its twin, the client's side first; None without a twin."""
        found: list[tuple[NestedCalls, _NewConversation, _NewConversation]] = []
        for suspect in new.suspects:
            other = self._new.get(suspect)
            if other is None:
                continue
            for outer, inner in permutations((new, other)):
                nested = nested_calls(outer.held, inner.held)
                if nested.proves_twins(fewest):
                    found.append((nested, outer, inner))
        if not found:
            return None
        _, outer, inner = max(found, key=lambda each: (each[0].calls, -each[0].lag))
        return outer, inner

    def _release(self, new: _NewConversation) -> None:
        """Pass a conversation without a twin on."""
        if len(self._single) >= MAX_CONVERSATIONS:
            self._single.clear()
            self._single_flows.clear()
            self._hidden.clear()
        self._single.add(new.conversation)
        for each in new.held:
            self._single_flows.add(each.flow)
            self._queue.add(each)
        self._drop_new(new.conversation)

    def _drop_new(self, conversation: Conversation) -> None:
        del self._new[conversation]
        if not self._new:
            self._senders.clear()

    def _pop_due(self) -> list[Observation]:
        now = self._now
        while self._new:
            first = next(iter(self._new.values()))
            if first.began + HELD_NS > now:
                break
            self._decide(first, FEWEST_CALLS)
        oldest = next(iter(self._new.values()), None)  # new conversations are in the order of their start
        until = now if oldest is None else min(now, oldest.began - 1)
        for merger in self._distinct_mergers():
            merger.expire(now)
            pending = merger.earliest_pending
            if pending is not None:
                until = min(until, pending - 1)
        due = self._queue.pop_until(until)
        if not self.passing:
            self._update_passing()
        return due

    def _update_passing(self) -> None:
        is_idle = not (self._new or self._mergers or self._queue)
        self.passing = self._single_flows if is_idle else set()

    def _distinct_mergers(self) -> Iterator[PlaceMerger]:
        return iter(dict.fromkeys(merger for merger, _ in self._mergers.values()))
