"""What a capture shows about the attempts of a client, and the ways in which they may form calls.

This module belongs to the oracle in `possible_worlds`, which describes the worlds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.observation import Direction
from tests.traffic.captured_sessions import MS, S_EXECUTING, US, Seen

SLACK = 500 * US
LONGEST_ROUND_TRIP = 100 * MS - SLACK
COINCIDENCES = 2
LONGEST_RUN = 64
"""The longest run of serials that were skipped because attempts were not captured."""
SHORTEST_TIMEOUT = 2 * MS
LONGEST_WAY = 1000 * MS

Times = tuple[int | None, ...]
NOWHERE: Times = (None,)


@dataclass(frozen=True)
class Sent:
    """A captured request, with its times at the places of capture, the client's side first."""

    serial: int
    reserved: int
    body: bytes = field(repr=False)
    times: Times = ()

    @property
    def is_first(self) -> bool:
        return self.reserved in (0, self.serial)

    @property
    def near(self) -> int:
        """When it passed the client's side."""
        return next(time for time in self.times if time is not None)


@dataclass(frozen=True)
class Attempt:
    """An attempt in a world. `request` and `reply` are the times at the places; all None if not captured."""

    serial: int
    request: Times
    reply: Times
    is_noticed: bool


@dataclass(frozen=True)
class Course:
    """One way in which the captured requests may form a call.

    Attributes:
        next_at: when the client's next request passed, ns; None if there is none.
        is_hasty: whether the client began the next call so soon that it may not wait for replies.
        is_joined: whether an attempt that was not captured joins two parts that may as well be two calls.
    """

    attempts: tuple[Attempt, ...]
    next_at: int | None
    is_joined: bool
    is_hasty: bool


def follower(serial: int) -> int:
    return serial % 0xFFFF + 1


def is_later(before: int, after: int) -> bool:
    return 0 < (after - before) % 0xFFFF < 0x8000


def between(before: int, after: int) -> list[int]:
    """Return the serials between two serials; none if the gap is too long for attempts that were missed."""
    found: list[int] = []
    serial = follower(before)
    while serial != after:
        found.append(serial)
        if len(found) > LONGEST_RUN:
            return []
        serial = follower(serial)
    return found


@dataclass
class Evidence:
    """What a capture shows, up to a frame.

    Attributes:
        place: named place of the capture: `client`, `controller`, `between`; None if it was not named.
        ended: when the latest frame was captured.
    """

    places: int
    place: str | None
    requests: list[Sent] = field(default_factory=list)
    replies: dict[int, Times] = field(default_factory=dict)
    noticed: dict[int, list[int]] = field(default_factory=dict)
    ended: int = 0

    @classmethod
    def of(cls, seen: Sequence[Seen], places: int, place: str | None, latest: int) -> Evidence:
        """Return the evidence of frames. `latest` is the time up to which all places captured."""
        found = cls(places, place, ended=max((each.time for each in seen), default=0))
        by_datagram: dict[int, list[Seen]] = {}
        for each in seen:
            by_datagram.setdefault(each.sent, []).append(each)
        passed = {direction: 0 for direction in Direction}  # latest first sighting of a frame seen everywhere
        for sightings in by_datagram.values():
            if len(sightings) == places:
                direction = sightings[0].direction
                passed[direction] = max(passed[direction], min(each.time for each in sightings))
        for sightings in by_datagram.values():
            first = min(each.time for each in sightings)
            is_pending = first > max(passed[sightings[0].direction], latest - LONGEST_WAY)
            by_place = {each.place: each.time for each in sightings}
            times = tuple(by_place.get(place, first if is_pending else None) for place in range(places))
            found._add(Frame(sightings[0].raw), sightings[0].direction, times)
        found.requests.sort(key=lambda sent: sent.near)
        return found

    def _add(self, frame: Frame, direction: Direction, times: Times) -> None:
        if direction is Direction.REQUEST:
            self.requests.append(Sent(frame.serial, frame.reserved, frame.raw[9:], times))
        elif frame.code == S_EXECUTING:
            passed = next(time for time in times if time is not None)
            self.noticed.setdefault(frame.serial, []).append(passed)
        else:
            self.replies[frame.serial] = times

    @property
    def unseen(self) -> Times:
        return NOWHERE * self.places

    # the client

    def conventions(self) -> set[str]:
        """Return the conventions that all captured requests fit."""
        firsts = [sent for sent in self.requests if sent.is_first]
        retries = [sent for sent in self.requests if not sent.is_first]
        by_serial = {sent.serial: sent for sent in self.requests}
        origins = [by_serial[sent.reserved] for sent in retries if sent.reserved in by_serial]
        known = [sent for sent in retries if sent.reserved in by_serial]
        found = set()
        if all(sent.reserved == sent.serial for sent in firsts) and all(sent.is_first for sent in origins):
            found.add("own")
        if all(sent.reserved == 0 for sent in firsts):
            found |= {"seed"} if all(sent.is_first for sent in origins) else set()
            found |= {"chain"} if all(follower(sent.reserved) == sent.serial for sent in known) else set()
        return found

    def origin(self, index: int, convention: str) -> int | None:
        """Return the serial of the first attempt of a captured request; None if it is not known."""
        sent = self.requests[index]
        if sent.is_first:
            return sent.serial
        if convention != "chain":
            return sent.reserved
        before = self.requests[index - 1] if index else None
        is_linked = before is not None and before.serial == sent.reserved
        return self.origin(index - 1, convention) if is_linked else None

    def longest_round_trip(self) -> int:
        if self.place == "client":
            return 0
        if any(
            self._is_hasty(before, after) and not self._is_answered_before(before, after)
            for before, after in pairwise(self.requests)
            if after.is_first
        ):
            return LONGEST_ROUND_TRIP
        calls = [
            (before, after)
            for before, after in pairwise(self.requests)
            if before.is_first and after.is_first and follower(before.serial) == after.serial
        ]
        reactions = sorted(
            after.near - reply
            for before, after in calls
            if (reply := self.replies.get(before.serial, self.unseen)[0]) is not None and reply < after.near
        )
        if len(reactions) <= COINCIDENCES:
            return LONGEST_ROUND_TRIP
        return min(2 * reactions[COINCIDENCES], LONGEST_ROUND_TRIP)

    def longest_wait(self) -> int:
        """Return the longest time for which the client waits for a reply."""
        waits = [2 * MS]
        for convention in self.conventions():
            for (number, before), after in zip(enumerate(self.requests), self.requests[1:], strict=False):
                origin = self.origin(number, convention)
                if not after.is_first and origin in (self.origin(number + 1, convention), after.reserved):
                    waits.append(
                        (after.near - before.near) // (1 + len(between(before.serial, after.serial)))
                    )
        return 2 * max(waits)

    # courses

    def told(self, serial: int) -> str:
        """Describe a captured request and the ones after it, for the message of a failed test."""
        index = self._index(serial)
        return " ".join(
            f"{sent.serial}/{sent.reserved} {sent.times}" for sent in self.requests[index : index + 5]
        )

    def _index(self, serial: int) -> int:
        return next(index for index, sent in enumerate(self.requests) if sent.serial == serial)

    def courses(self, serial: int) -> Iterator[Course]:
        """Yield each way in which a captured request and its neighbours may form a call."""
        index = self._index(serial)
        for convention in sorted(self.conventions()):
            for first, last in self._ranges(index, convention):
                for start in self._starts(first, convention):
                    own = range(first, last + 1)
                    serials = self._serials_of(own, start)
                    following = self.requests[last + 1] if last + 1 < len(self.requests) else None
                    for count in range(len(gap := self._gap_behind(last, convention)) + 1):
                        is_joined = any(self._tie(each, convention) == 2 for each in own[:-1])
                        yield self._course([*serials, *gap[:count]], own, following, is_joined)

    def _ranges(self, index: int, convention: str) -> Iterator[tuple[int, int]]:
        """Yield the first and last captured request of the call that holds a captured request."""
        firsts, lasts = [index], [index]
        while firsts[-1] and (tie := self._tie(firsts[-1] - 1, convention)):
            firsts = [*firsts[: tie - 2 or None], firsts[-1] - 1]
        while lasts[-1] + 1 < len(self.requests) and (tie := self._tie(lasts[-1], convention)):
            lasts = [*lasts[: tie - 2 or None], lasts[-1] + 1]
        yield from product(firsts, lasts)

    def _tie(self, index: int, convention: str) -> int:
        """Return 1 if the next captured request is a retry of a captured one, 2 if it may be; else 0."""
        before, after = self.requests[index], self.requests[index + 1]
        if after.is_first or before.body != after.body:
            return 0
        if convention != "chain":
            return int(self.origin(index, convention) == after.reserved)
        if before.serial == after.reserved:
            return 1
        return 2 if between(before.serial, after.serial) else 0

    def _starts(self, first: int, convention: str) -> list[int]:
        """Return the serials that may be the first of the call of a captured request."""
        origin = self.origin(first, convention)
        if origin is not None:
            return [origin]
        serial = self.requests[first].reserved
        gap = between(self.requests[first - 1].serial, serial) if first else []
        return [serial, *gap]

    def _serials_of(self, own: range, start: int) -> list[int]:
        serials = [start]
        while serials[-1] != self.requests[own[-1]].serial:
            serials.append(follower(serials[-1]))
        return serials

    def _gap_behind(self, last: int, convention: str) -> list[int]:
        """Return the serials that were skipped behind a captured request and may belong to its call."""
        serial = self.requests[last].serial
        if last + 1 < len(self.requests):
            following = self.requests[last + 1]
            return between(serial, following.serial if following.is_first else following.reserved)
        ahead = [len(between(serial, reply)) + 1 for reply in self.replies if reply != serial]
        steps = max((step for step in ahead if step > 1 or follower(serial) in self.replies), default=0)
        found = [serial]
        for _ in range(steps):
            found.append(follower(found[-1]))
        return found[1:]

    def _course(self, serials: Sequence[int], own: range, following: Sent | None, is_joined: bool) -> Course:
        sent = {self.requests[number].serial: self.requests[number].times for number in own}
        attempts = tuple(
            Attempt(
                serial,
                sent.get(serial, self.unseen),
                self.replies.get(serial, self.unseen),
                serial in self.noticed,
            )
            for serial in serials
        )
        is_hasty = following is not None and self._is_hasty(self.requests[own[-1]], following)
        return Course(attempts, None if following is None else following.near, is_joined, is_hasty)

    def _is_answered_before(self, before: Sent, after: Sent) -> bool:
        """Return whether a reply passed the client's side before the next request."""
        reply = self.replies.get(before.serial, self.unseen)[0]
        return reply is not None and reply < after.near

    def _is_hasty(self, before: Sent, after: Sent) -> bool:
        """Return whether a call began so soon after a request, or S_EXECUTING for it, that its client may not
        wait for replies."""
        notices = [time for time in self.noticed.get(before.serial, ()) if time < after.near]
        return after.near - max([before.near, *notices]) < SHORTEST_TIMEOUT
