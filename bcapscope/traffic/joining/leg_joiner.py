"""Join the two legs of the conversations that a running proxy relays."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.messages import Message
from bcapscope.traffic.joining.delivery_queue import DeliveryQueue
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import JOIN_WITHIN_NS, PlaceMerger
from bcapscope.traffic.observation import Conversation, Observation


class RelayedObservation(Observation):
    """A frame on one leg of a proxy.

    Attributes:
        note: What a rule of the proxy did to the frame; None if no rule changed it.
    """

    note: Message | None


class LegJoiner:
    """Joins the legs that the caller names, and returns all observations in order of time.

    A frame that the proxy did not forward waits until the proxy can no longer forward it. Until then, all
    later observations wait, too.

    Attributes:
        delivered_until: Time up to which all observations were returned, ns since 1970.
    """

    def __init__(self) -> None:
        self.delivered_until = 0
        self._mergers: dict[Conversation, tuple[PlaceMerger, CapturePlace]] = {}
        self._queue = DeliveryQueue()
        self._now = 0

    @property
    def is_idle(self) -> bool:
        """Whether no conversation is joined and no observation waits, so observations need not be added."""
        return not (self._mergers or self._queue)

    def join(self, client_leg: Conversation, controller_leg: Conversation) -> None:
        """Join the further observations of two conversations."""
        client_leg.controller_leg = controller_leg
        merger = PlaceMerger(client_leg, self._queue.add, notes_of=_notes_of)
        self._mergers[client_leg] = merger, CapturePlace.CLIENT_SIDE
        self._mergers[controller_leg] = merger, CapturePlace.CONTROLLER_SIDE

    def add(self, observation: Observation) -> list[Observation]:
        """Add the next observation; return the observations that are due, in order of time."""
        due = self._restart_if_set_back(observation.time)
        leg = self._mergers.get(observation.flow.conversation)
        if leg is None:
            self._queue.add(observation)
        else:
            merger, place = leg
            merger.add(observation, place)
        return [*due, *self.expire(observation.time)]

    def expire(self, now: int) -> list[Observation]:
        """Return the observations that are due at the time `now`, ns since 1970."""
        due = self._restart_if_set_back(now)
        self._now = until = max(self._now, now)
        for merger in self._distinct_mergers():
            merger.expire(self._now)
            pending = merger.earliest_pending
            if pending is not None:
                until = min(until, pending - 1)
        self.delivered_until = until
        return [*due, *self._queue.pop_until(until)]

    def close_conversation(self, client_leg: Conversation) -> list[Observation]:
        """Return all observations of a client that has disconnected, and drop its data."""
        merger, _ = self._mergers.pop(client_leg, (None, None))
        if merger is not None:
            merger.close()
            self._mergers = {leg: each for leg, each in self._mergers.items() if each[0] is not merger}
        return self._queue.remove(client_leg)

    def close(self) -> list[Observation]:
        """Return all observations that wait, because the traffic has ended."""
        for merger in self._distinct_mergers():
            merger.close()
        return self._queue.pop_all()

    def _restart_if_set_back(self, now: int) -> list[Observation]:
        """If the clock was set back, return all observations that wait, and follow the clock."""
        if now >= self._now - JOIN_WITHIN_NS:
            return []
        self._now = now
        return self.close()

    def _distinct_mergers(self) -> Iterator[PlaceMerger]:
        return (merger for merger, place in self._mergers.values() if place is CapturePlace.CLIENT_SIDE)


def _notes_of(observation: Observation) -> tuple[str, ...]:
    note = observation.note if isinstance(observation, RelayedObservation) else None
    return () if note is None else (str(note),)
