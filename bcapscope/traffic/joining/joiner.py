"""Find and join the observations of each conversation that was captured at several places."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import permutations

from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.leg_joiner import LegJoiner
from bcapscope.traffic.joining.place_merger import CapturedTwins, CaptureSide, PlaceMerger
from bcapscope.traffic.joining.twin_recognition import (
    ENOUGH_CALLS,
    NestedCalls,
    fewest_calls,
    may_be_twins,
    nested_calls,
)
from bcapscope.traffic.observation import Conversation, Direction, Flow, Observation

HELD_NS = 1_000_000_000
"""Maximum time in ns for which a new conversation is held while the joiner looks for its other leg."""

HELD_UNANSWERED_NS = 5_000_000_000
"""Maximum time in ns for which a new conversation is held if it has no reply. The proxy may have dropped the
client's first requests. The client then retries within `RETRY_WITHIN_NS`, and the other leg begins.
"""

MAX_WAITING = 32768
"""Maximum number of waiting observations. Beyond the limit, the joiner immediately decides which
conversations to join, and returns the waiting observations.
"""

HELD_FRAMES = 512
"""Maximum number of frames of a new conversation that are held until the other leg is known."""

OWN_CALLS = 2
"""A new conversation with this number of answered calls, but without suspects, has no second leg. The second
leg would have appeared earlier, because a proxy forwards each request to the controller before the client
gets the reply.
"""

MAX_NEW = 1024

MAX_SUSPECTS = 32

MAX_CONVERSATIONS = 4096
"""Maximum number of conversations without a second leg that the joiner remembers. When there is one more, the
joiner forgets all of them. If the traffic of such a conversation continues, the joiner examines the
conversation again.
"""

MAX_JOINED = 256
"""Maximum number of joined conversations. When there is one more, the joiner no longer joins the legs of the
conversation that it joined first.
"""

MAX_SENDERS = 16

MAX_REQUESTS = 65536

_REQUEST = Direction.REQUEST


class _NewConversation:
    """A conversation that may turn out to be the leg of a proxy, with its traffic so far.

    Attributes:
        suspects: Other conversations with a request that this conversation also has. Each suspect may be the
            other leg.
    """

    def __init__(self, first: Observation) -> None:
        self.conversation = first.flow.conversation
        self.began = first.time
        self.held: list[Observation] = []
        self.suspects: dict[Conversation, None] = {}
        self._open: set[int] = set()
        self.answered = 0

    @property
    def due_at(self) -> int:
        """Time until which the joiner holds the conversation, ns since 1970."""
        return self.began + (HELD_NS if self.answered else HELD_UNANSWERED_NS)

    def add(self, observation: Observation) -> None:
        self.held.append(observation)
        serial = getattr(observation.item, "serial", -1)
        if observation.flow.direction is _REQUEST:
            self._open.add(serial)
        elif serial in self._open:
            self._open.discard(serial)
            self.answered += 1

    def add_suspect(self, conversation: Conversation) -> None:
        if len(self.suspects) < MAX_SUSPECTS:
            self.suspects[conversation] = None

    def drop_before(self, client_side: _NewConversation) -> None:
        """Drop the frames before the first frame that `client_side` also holds."""
        waiting = {each.item.raw for each in client_side.held}
        while self.held and self.held[0].item.raw not in waiting:
            del self.held[0]


class Joiner(LegJoiner):
    """Finds and joins the two legs of a proxied conversation, which a capture holds as two conversations.

    The joiner holds a new conversation for at most `HELD_NS`, or `HELD_UNANSWERED_NS` if there is no reply,
    while the second leg may still appear. The joiner returns observations of joined conversations as
    `JoinedObservation`, and all other observations unchanged. The flows in `passing` belong to conversations
    without a second leg. Callers need not add observations of these flows, because `add` would return each
    one immediately.
    """

    def __init__(
        self, comments: Mapping[int, tuple[str, ...]] | None = None, only: CapturePlace | None = None
    ) -> None:
        """Start without conversations.

        Args:
            comments: Comments on the latest packets, by packet number.
            only: Place whose observations the joiner returns, without joining; None to join both places.
        """
        notes = {} if comments is None else comments
        super().__init__(lambda observation: notes.get(observation.packet, ()))
        self.passing: set[Flow] = set()
        self._only = only
        self._hidden: set[Conversation] = set()
        self._shown_legs: set[Conversation] = set()  # their other legs are hidden
        self._single_flows: set[Flow] = set()
        self._single: set[Conversation] = set()
        self._new: dict[Conversation, _NewConversation] = {}
        self._senders: dict[bytes, dict[Conversation, None]] = {}
        self._captured_twins: dict[CapturedTwins, PlaceMerger] = {}
        self._next_due = 0

    @property
    def own_requests(self) -> int:
        """Number of requests that proxies sent on their own, for example to close a session."""
        return sum(merger.own_requests for merger in self._distinct_mergers())

    def expire(self, now: int) -> list[Observation]:
        # `now` can be earlier than the latest packet, but `expire` must not set the joiner's time back
        return super().expire(max(self._now, now))

    def close(self) -> list[Observation]:
        self._decide_all()
        return super().close()

    def _add_unmerged(self, observation: Observation) -> None:
        flow = observation.flow
        if flow.conversation in self._single:
            self._single_flows.add(flow)
            self._queue.add(observation)
            if self._new and flow.direction is _REQUEST:
                self._note_sender(observation)
        elif flow.conversation not in self._hidden:
            self._add_new(observation)

    def _add_captured_twin(self, observation: Observation, side: CaptureSide) -> None:
        """Add the first observation of a conversation that two captures hold."""
        conversation, twins = observation.flow.conversation, side.twins
        if self._only is not None:
            if side.place is self._only:
                self._single.add(conversation)
                self._shown_legs.add(conversation)
                self._queue.add(observation)
            else:
                self._hidden.add(conversation)
            return
        merger = self._captured_twins.get(twins)
        if merger is None:
            merger = PlaceMerger(
                _joined_conversation(conversation, side), self._queue.add, self._notes_of, twins
            )
            self._captured_twins[twins] = merger
        joined = merger.conversation
        if side.place is CapturePlace.CONTROLLER_SIDE:
            if twins.is_relayed and joined.controller_leg is None:
                joined.controller_leg = conversation
        elif joined is not conversation:
            conversation.joined_as = joined
            joined.connection_end = conversation.connection_end
        self.passing = set()
        self._mergers[conversation] = merger, side.place
        self._merge(observation)

    def _add_new(self, observation: Observation) -> None:
        conversation = observation.flow.conversation
        if conversation.capture_side is not None:
            self._add_captured_twin(observation, conversation.capture_side)
            return
        new = self._new.get(conversation)
        if new is None:
            self.passing = set()
            new = self._new[conversation] = _NewConversation(observation)
            if len(self._new) > MAX_NEW:
                self._decide(next(iter(self._new.values())))
        new.add(observation)
        self._next_due = min(self._next_due, new.due_at)
        if observation.flow.direction is _REQUEST:
            self._find_suspects(new, observation)
        if new.answered >= OWN_CALLS and not new.suspects:
            self._release(new)
        elif new.answered >= ENOUGH_CALLS and new.answered % ENOUGH_CALLS == 0:
            twins = self._best_twins(new, ENOUGH_CALLS)
            if twins is not None:
                self._join(*twins)
        if len(new.held) >= HELD_FRAMES and conversation in self._new:
            self._decide(new)

    def _find_suspects(self, new: _NewConversation, request: Observation) -> None:
        """Find the conversations that contain a request equal to `request`, and that may be the other leg of
        `new`. Add them to `new.suspects`. If such a conversation is new, too, add `new` to its suspects.
        """
        for sender in self._note_sender(request):
            if not may_be_twins(sender, new.conversation):
                continue
            other = self._new.get(sender)
            if other is not None:
                other.add_suspect(new.conversation)
            if other is not None or sender in self._single:
                new.add_suspect(sender)

    def _note_sender(self, request: Observation) -> list[Conversation]:
        """Remember the conversation of a request. Return the other conversations with the same request."""
        if len(self._senders) >= MAX_REQUESTS:
            self._senders.clear()
        senders = self._senders.setdefault(request.item.raw, {})
        others = [each for each in senders if each is not request.flow.conversation]
        if len(senders) < MAX_SENDERS:
            senders[request.flow.conversation] = None
        return others

    def _decide(self, new: _NewConversation) -> None:
        twins = self._best_twins(new)
        if twins is None:
            self._release(new)
        else:
            self._join(*twins)

    def _join(self, client_side: _NewConversation, controller_side: _NewConversation) -> None:
        twins = client_side, controller_side
        if client_side.conversation in self._single:
            controller_side.drop_before(client_side)
        for twin in twins:
            self._take_over(twin)
        if self._only is not None:
            shown = twins[self._only]
            self._release(shown)
            self._shown_legs.add(shown.conversation)
            self._hidden.add(twins[1 - self._only].conversation)
            return
        if len(self._mergers) >= 2 * MAX_JOINED:
            self._stop_joining(next(iter(self._mergers.values()))[0])
        self.join(client_side.conversation, controller_side.conversation)
        for each in sorted((*client_side.held, *controller_side.held), key=lambda seen: seen.number):
            self._merge(each)

    def _take_over(self, twin: _NewConversation) -> None:
        """Remove a conversation from the joiner's tables. Move its queued observations to `twin.held`."""
        conversation = twin.conversation
        if conversation in self._single:
            self._single.remove(conversation)
            self._single_flows -= {each for each in self._single_flows if each.conversation is conversation}
            twin.held = self._queue.remove(conversation)
        else:
            self._drop_new(conversation)

    def _best_twins(
        self, new: _NewConversation, calls: int = 0
    ) -> tuple[_NewConversation, _NewConversation] | None:
        """Return the client's leg and the controller's leg; None if no suspect is the other leg of `new`.

        Two conversations count as legs only if they have at least `calls` nested calls (see `NestedCalls`).
        If `calls` is 0, the minimum is the number that `fewest_calls` returns.
        """
        found: list[tuple[NestedCalls, _NewConversation, _NewConversation]] = []
        waiting = self._waiting_traffic(new.suspects)
        for suspect in new.suspects:
            other = self._new.get(suspect) or waiting.get(suspect)
            if other is None:
                continue
            for outer, inner in permutations((new, other)):
                fewest = fewest_calls(outer.conversation, inner.conversation)
                nested = nested_calls(outer.held, inner.held)
                if fewest is not None and nested.proves_twins(calls or fewest):
                    found.append((nested, outer, inner))
        if not found:
            return None
        _, outer, inner = max(found, key=lambda each: (each[0].calls, -each[0].lag))
        return outer, inner

    def _waiting_traffic(self, suspects: Iterable[Conversation]) -> dict[Conversation, _NewConversation]:
        """Return the queued observations of each suspect that the joiner already treats as a conversation
        without a second leg. Such a suspect can still be the client's leg. If the proxy dropped the client's
        first request, the client's leg begins long before the controller's leg.
        """
        single = {each for each in suspects if each in self._single and each not in self._shown_legs}
        found: dict[Conversation, _NewConversation] = {}
        for conversation, waiting in (self._queue.find(single) if single else {}).items():
            traffic = found[conversation] = _NewConversation(waiting[0])
            traffic.held = waiting[-HELD_FRAMES:]
        return found

    def _release(self, new: _NewConversation) -> None:
        """Release the held observations of a conversation that has no second leg."""
        if len(self._single) >= MAX_CONVERSATIONS:
            self._single.clear()
            self._single_flows.clear()
            self._hidden.clear()
            self._shown_legs.clear()
        self._single.add(new.conversation)
        for each in new.held:
            self._single_flows.add(each.flow)
            self._queue.add(each)
        self._drop_new(new.conversation)

    def _drop_new(self, conversation: Conversation) -> None:
        self._new.pop(conversation, None)
        if not self._new:
            self._senders.clear()

    def _pop_due(self) -> list[Observation]:
        now = self._now
        if self._new and now >= self._next_due:
            self._decide_due(now)
        if len(self._queue) > MAX_WAITING:
            self._decide_all()
            self._close_mergers()
        # `_new` lists the conversations in the order in which they began
        oldest = next(iter(self._new.values()), None)
        due = self._pop_until(now if oldest is None else min(now, oldest.began - 1))
        if not self.passing:
            self._update_passing()
        return due

    def _decide_due(self, now: int) -> None:
        for new in [each for each in self._new.values() if each.due_at <= now]:
            if new.conversation in self._new:
                self._decide(new)
        self._next_due = min((each.due_at for each in self._new.values()), default=now)

    def _decide_all(self) -> None:
        while self._new:
            self._decide(next(iter(self._new.values())))

    def _update_passing(self) -> None:
        self.passing = self._single_flows if self.is_idle and not self._new else set()


def _joined_conversation(first: Conversation, side: CaptureSide) -> Conversation:
    """Return the conversation at the client's side. `side` says where conversation `first` was captured."""
    ends = side.twins.client_ends
    if side.place is CapturePlace.CLIENT_SIDE or ends is None:
        return first
    return Conversation(*ends, first.server_evidence)
