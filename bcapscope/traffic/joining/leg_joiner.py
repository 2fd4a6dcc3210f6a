"""Join the two legs of conversations through a proxy, and return all observations in order of time."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Container, Iterable

from bcapscope.messages import Message
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import JOIN_WITHIN_NS, PlaceMerger
from bcapscope.traffic.observation import Conversation, Observation


class RelayedObservation(Observation):
    """A frame on one leg of a proxy. `note` says what a rule of the proxy did to the frame, if anything."""

    note: Message | None


def _notes_of_relay(observation: Observation) -> tuple[str, ...]:
    note = observation.note if isinstance(observation, RelayedObservation) else None
    return () if note is None else (str(note),)


class DeliveryQueue:
    """Observations that wait for delivery, ordered by time, then by number."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, Observation]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, observation: Observation) -> None:
        heapq.heappush(self._waiting, (observation.time, observation.number, observation))

    def pop_until(self, time: int) -> list[Observation]:
        waiting, due = self._waiting, []
        while waiting and waiting[0][0] <= time:
            due.append(heapq.heappop(waiting)[2])
        return due

    def find(self, conversations: Container[Conversation]) -> dict[Conversation, list[Observation]]:
        """Return the waiting observations of each conversation in `conversations`, in order of time."""
        found: dict[Conversation, list[Observation]] = {}
        for _, _, each in sorted(
            each for each in self._waiting if each[2].flow.conversation in conversations
        ):
            found.setdefault(each.flow.conversation, []).append(each)
        return found

    def remove(self, conversation: Conversation) -> list[Observation]:
        removed = self.find((conversation,)).get(conversation, [])
        self._waiting = [each for each in self._waiting if each[2].flow.conversation is not conversation]
        heapq.heapify(self._waiting)
        return removed

    def pop_all(self) -> list[Observation]:
        due = [each for _, _, each in sorted(self._waiting)]
        self._waiting.clear()
        return due


class LegJoiner:
    """Joins the legs that the caller names, and returns all observations in order of time.

    A frame on one leg waits at most `JOIN_WITHIN_NS` for the same frame on the other leg. Meanwhile, all
    later observations wait too. The joiner has returned all observations up to the time `delivered_until`, ns
    since 1970.
    """

    def __init__(self, notes_of: Callable[[Observation], Iterable[str]] = _notes_of_relay) -> None:
        """Start without conversations. `notes_of` returns what a proxy noted on a sighting."""
        self.delivered_until = 0
        self._notes_of = notes_of
        self._mergers: dict[Conversation, tuple[PlaceMerger, CapturePlace]] = {}
        self._busy: dict[PlaceMerger, None] = {}  # mergers that may hold frames
        self._queue = DeliveryQueue()
        self._now = 0

    @property
    def is_idle(self) -> bool:
        """True if the joiner joins no legs and holds no observations. While a `LegJoiner` is idle, callers
        need not call `add`, because `add` would return each observation immediately.
        """
        return not (self._mergers or self._queue)

    def join(self, client_leg: Conversation, controller_leg: Conversation) -> None:
        client_leg.controller_leg = controller_leg
        merger = PlaceMerger(client_leg, self._queue.add, self._notes_of)
        self._mergers[client_leg] = merger, CapturePlace.CLIENT_SIDE
        self._mergers[controller_leg] = merger, CapturePlace.CONTROLLER_SIDE

    def add(self, observation: Observation) -> list[Observation]:
        """Add the next observation; return the observations that are due, in order of time."""
        due = self._restart_if_set_back(observation.time)
        self._now = max(self._now, observation.time)
        if not self._merge(observation):
            self._add_unmerged(observation)
        return due + self._pop_due()

    def expire(self, now: int) -> list[Observation]:
        """Return the observations that are due at the time `now`, ns since 1970."""
        due = self._restart_if_set_back(now)
        self._now = max(self._now, now)
        return due + self._pop_due()

    def close_conversation(self, client_leg: Conversation) -> list[Observation]:
        """Return all observations of a client that has disconnected, and drop its data."""
        if client_leg in self._mergers:
            self._stop_joining(self._mergers[client_leg][0])
        return self._queue.remove(client_leg)

    def close(self) -> list[Observation]:
        self._close_mergers()
        return self._queue.pop_all()

    def _merge(self, observation: Observation) -> bool:
        """Add an observation to the merger of its conversation; return False if there is no merger."""
        found = self._mergers.get(observation.flow.conversation)
        if found is None:
            return False
        merger, place = found
        merger.add(observation, place)
        self._busy[merger] = None
        return True

    def _add_unmerged(self, observation: Observation) -> None:
        self._queue.add(observation)

    def _pop_due(self) -> list[Observation]:
        return self._pop_until(self._now)

    def _pop_until(self, until: int) -> list[Observation]:
        """Return the queued observations up to the time `until`. If a frame still waits for its sighting on
        the other leg, return only the observations that are earlier than this frame.
        """
        for merger in list(self._busy):
            merger.expire(self._now)
            pending = merger.earliest_pending
            if pending is None:
                del self._busy[merger]
            else:
                until = min(until, pending - 1)
        self.delivered_until = until
        return self._queue.pop_until(until)

    def _restart_if_set_back(self, now: int) -> list[Observation]:
        """If the clock was set back, return all waiting observations, and continue from the time `now`."""
        if now >= self._now - JOIN_WITHIN_NS:
            return []
        due = self.close()
        self._now = now
        return due

    def _stop_joining(self, merger: PlaceMerger) -> None:
        merger.close()
        self._mergers = {leg: each for leg, each in self._mergers.items() if each[0] is not merger}

    def _close_mergers(self) -> None:
        for merger in self._distinct_mergers():
            merger.close()

    def _distinct_mergers(self) -> list[PlaceMerger]:
        return list(dict.fromkeys(merger for merger, _ in self._mergers.values()))
