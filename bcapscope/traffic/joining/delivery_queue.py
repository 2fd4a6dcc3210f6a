"""Put the observations of several conversations in order of time."""

from __future__ import annotations

import heapq

from bcapscope.traffic.observation import Conversation, Observation


class DeliveryQueue:
    """Observations that wait until no earlier observation can be added; ordered by time, then by number."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, Observation]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, observation: Observation) -> None:
        heapq.heappush(self._waiting, (observation.time, observation.number, observation))

    def pop_until(self, time: int) -> list[Observation]:
        """Remove and return the observations up to and including `time`, ns since 1970."""
        waiting, due = self._waiting, []
        while waiting and waiting[0][0] <= time:
            due.append(heapq.heappop(waiting)[2])
        return due

    def remove(self, conversation: Conversation) -> list[Observation]:
        """Remove and return the observations of a conversation, in order of time."""
        removed = [each for each in self._waiting if each[2].flow.conversation is conversation]
        self._waiting = [each for each in self._waiting if each[2].flow.conversation is not conversation]
        heapq.heapify(self._waiting)
        return [observation for _, _, observation in sorted(removed)]

    def pop_all(self) -> list[Observation]:
        due = [each for _, _, each in sorted(self._waiting)]
        self._waiting.clear()
        return due
