"""Merge the captures of one conversation from two places: each frame occurs once, with its sightings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

from bcapscope.traffic.joining.frame_sample import ConversationEnds
from bcapscope.traffic.joining.joined_observation import CapturePlace, JoinedObservation, join_sightings
from bcapscope.traffic.observation import Conversation, Direction, Flow, Observation, Transport

JOIN_WITHIN_NS = 1_000_000_000
"""Maximum time in ns for which a frame waits for its second sighting. The time allows for delay faults of a
proxy. After this time, a frame without a second sighting normally counts as lost.
"""

MAX_PENDING = 65536
"""Maximum number of frames that wait for a second sighting. Beyond the limit, bcapscope delivers the oldest
waiting frame without waiting any longer for its second sighting.
"""

MAX_COMPARED = 1024

MAX_OVERDUE = 256
"""Maximum number of remembered frames that count as lost. A request that counts as lost can still be captured
at the controller's side, for example if the proxy holds this request and you release it later.
"""


@dataclass(frozen=True, slots=True)
class Coverage:
    """Time span of a capture: the times of its first and its last packet, ns since 1970. If `begins` is None,
    the span has no start. If `ends` is None, the span has no end.
    """

    begins: int | None = None
    ends: int | None = None


@dataclass(frozen=True, eq=False)
class CapturedTwins:
    """What is known about the captures at the client's and at the controller's side. Compared by identity.

    Attributes:
        clock_error: Uncertainty of the difference between the clocks of both captures, ns.
        is_relayed: Whether a proxy is between the places.
        client_ends: Addresses at the client's side; None if unknown.
    """

    coverage: tuple[Coverage, Coverage] = (Coverage(), Coverage())
    clock_error: int = 0
    is_relayed: bool = True
    client_ends: ConversationEnds | None = None


LEGS_OF_PROXY = CapturedTwins()


class CaptureSide(NamedTuple):
    twins: CapturedTwins
    place: CapturePlace


@dataclass(slots=True, eq=False)
class _Waiting:
    """A frame that one place has captured, and that the other place may still capture."""

    place: CapturePlace
    observation: Observation
    is_resolved: bool = False


class PlaceMerger:
    """Merges the observations of one conversation from two places. Callers add observations in order of time.

    The merger recognises a frame by its direction and bytes, or by its serial if a proxy changed the bytes.
    """

    def __init__(
        self,
        conversation: Conversation,
        deliver: Callable[[JoinedObservation], object],
        notes_of: Callable[[Observation], Iterable[str]],
        twins: CapturedTwins = LEGS_OF_PROXY,
    ) -> None:
        """`deliver` receives each joined observation, but not in order of time; see `earliest_pending`.
        `notes_of` returns what a proxy noted on a sighting.
        """
        self.conversation = conversation
        self._deliver = deliver
        self._notes_of = notes_of
        self._twins = twins
        self._flows = {direction: Flow(conversation, direction) for direction in Direction}
        self._pending: deque[_Waiting] = deque()
        self._by_bytes: dict[tuple[Direction, bytes], list[_Waiting]] = {}
        self._overdue: dict[tuple[Direction, bytes], JoinedObservation] = {}
        self._own_serials: set[int | None] = set()
        self.own_requests = 0
        self._latest_joined = dict.fromkeys(Direction, 0)

    @property
    def earliest_pending(self) -> int | None:
        """Time of the earliest frame that is not delivered yet, ns since 1970."""
        pending = self._pending
        while pending and pending[0].is_resolved:
            pending.popleft()
        return pending[0].observation.time if pending else None

    def add(self, observation: Observation, place: CapturePlace) -> None:
        flow = observation.flow
        if flow.conversation is self.conversation:
            self._flows[flow.direction] = flow
        key = flow.direction, observation.item.raw
        others = self._by_bytes.get(key)
        if others is not None:
            twin = next((each for each in others if each.place is not place), None)
            if twin is not None:
                self._forget(key, twin)
                self._join(twin, place, observation)
                return
        elif self._overdue and self._complete_overdue(key, place, observation):
            return
        waiting = _Waiting(place, observation)
        self._pending.append(waiting)
        self._by_bytes.setdefault(key, []).append(waiting)
        if len(self._pending) > MAX_PENDING and self.earliest_pending is not None:
            self._give_up(self._pending.popleft(), is_at_end=True)

    def expire(self, now: int) -> None:
        """Deliver the frames that the other place should have captured by `now`, ns since 1970."""
        while (pending := self.earliest_pending) is not None and pending + JOIN_WITHIN_NS < now:
            self._give_up(self._pending.popleft(), is_at_end=False)

    def close(self) -> None:
        while self.earliest_pending is not None:
            self._give_up(self._pending.popleft(), is_at_end=True)

    def _join(self, twin: _Waiting, place: CapturePlace, observation: Observation) -> None:
        twin.is_resolved = True
        ends = (
            (twin.observation, observation)
            if place is CapturePlace.CONTROLLER_SIDE
            else (observation, twin.observation)
        )
        direction = observation.flow.direction
        self._latest_joined[direction] = max(self._latest_joined[direction], twin.observation.time)
        self._deliver(self._joined(*ends))

    def _give_up(self, waiting: _Waiting, *, is_at_end: bool) -> None:
        """Deliver a frame that waited in vain: the other place did not capture the same bytes in time."""
        observation, place = waiting.observation, waiting.place
        direction = observation.flow.direction
        key = direction, observation.item.raw
        self._forget(key, waiting)
        changed = self._find_changed(waiting)
        if changed is not None:
            self._forget((direction, changed.observation.item.raw), changed)
            changed.is_resolved = True
            self._join(waiting, changed.place, changed.observation)
            return
        ends = (observation, None) if place is CapturePlace.CLIENT_SIDE else (None, observation)
        joined = self._joined(*ends, is_missed=self._is_missed(observation, place, is_at_end))
        if joined.was_made_between and joined.is_request:
            self.own_requests += 1
            self._own_serials.add(_serial_of(observation))
        if joined.was_lost_between:
            self._overdue[key] = joined
            if len(self._overdue) > MAX_OVERDUE:
                del self._overdue[next(iter(self._overdue))]
        self._deliver(joined)

    def _joined(
        self, at_client: Observation | None, at_controller: Observation | None, *, is_missed: bool = False
    ) -> JoinedObservation:
        seen = [each for each in (at_client, at_controller) if each is not None]
        notes = dict.fromkeys(note for each in seen for note in self._notes_of(each))
        return join_sightings(
            at_client,
            at_controller,
            self._flows[seen[0].flow.direction],
            is_missed=is_missed,
            is_relayed=self._twins.is_relayed,
            note="; ".join(notes),
            delay_error=self._twins.clock_error,
        )

    def _is_missed(self, observation: Observation, place: CapturePlace, is_at_end: bool) -> bool:
        """Return whether the capture at the other place was running when the frame should have been there."""
        is_relayed = self._twins.is_relayed
        if not is_relayed and self.conversation.transport is Transport.TCP:
            return False  # TCP delivers all bytes, so only the capture lacks the frame
        other, time = self._twins.coverage[1 - place], observation.time
        if other.begins is not None and time < other.begins:
            return False
        is_sender_side = (place is CapturePlace.CONTROLLER_SIDE) is (
            observation.flow.direction is Direction.REQUEST
        )
        if is_sender_side or _serial_of(observation) in self._own_serials:
            return True  # a frame passes the sender's side first and cannot be captured there later
        closing = self.conversation.connection_end
        if is_relayed and closing is not None and closing.ends_replies:
            return True  # the connection has ended, so no further frame can come
        if is_at_end or (other.ends is not None and time > other.ends - JOIN_WITHIN_NS):
            return time < self._latest_joined[observation.flow.direction]
        return True

    def _forget(self, key: tuple[Direction, bytes], waiting: _Waiting) -> None:
        others = self._by_bytes[key]
        others.remove(waiting)
        if not others:
            del self._by_bytes[key]

    def _find_changed(self, waiting: _Waiting) -> _Waiting | None:
        """Return the waiting frame from the other place that has the serial and direction of `waiting`."""
        direction = waiting.observation.flow.direction
        serial = _serial_of(waiting.observation)
        if serial is None:
            return None
        return next(
            (
                each
                for each in islice(self._pending, MAX_COMPARED)
                if not each.is_resolved
                and each.place is not waiting.place
                and each.observation.flow.direction is direction
                and _serial_of(each.observation) == serial
            ),
            None,
        )

    def _complete_overdue(
        self, key: tuple[Direction, bytes], place: CapturePlace, observation: Observation
    ) -> bool:
        """Add the controller-side sighting of a request that counted as lost; else return False."""
        joined = self._overdue.get(key)
        if joined is None or not joined.is_request or place is not CapturePlace.CONTROLLER_SIDE:
            return False
        del self._overdue[key]
        joined.at_controller = observation
        joined.is_missed = False
        return True


def _serial_of(observation: Observation) -> int | None:
    return getattr(observation.item, "serial", None)
