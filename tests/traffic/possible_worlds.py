"""Every course of a call that gives the same capture: an oracle for "cannot tell".

The oracle reads only what was captured. It shares no code with the package's pairing. It takes each choice
that the capture leaves open, and checks whether true times exist that fit: times of sending and of arrival,
as a system of difference constraints.

What the worlds of one session share, because it is a fact about the client, the network or the capture:

- The convention of the reserved field. A world may have any convention that all captured requests fit.
- The place of capture, if it was named. At the controller, nothing is lost behind the capture. If the place
  was not named, it is on the way, and frames are lost before and behind it.
- The longest round trip from the capture to the client and back: twice that which the client's reactions
  show, 99.5 ms if there are none. Two reactions may be a coincidence, so the third-shortest counts. A reaction
  counts only after a call of a single attempt, if no serial was skipped before the next request, and only if
  the client waits for replies (see below).
- The longest wait for a reply: twice the longest distance between two attempts, for calls without S_EXECUTING.

What is free in each world and call:

- The capture lacks any request without notice, but no reply. Two captures lack a request both or not at all.
- Each request and each reply is lost or not, before, between or behind the places. A reply that has reached
  the client's computer may still be lost there. A client that already prepares a retry does not read a reply
  for up to 0.5 ms.
- The number of attempts and the client's pauses. A client that begins a call within 2 ms after a request, or
  after S_EXECUTING, may still accept the reply to the call before.

A frame that only one of two places has may have passed the other one as well, if it is one of the last: within
1 s before the end, with no later frame of its direction at both. The other capture may have ended before.

The controller answers each attempt that reaches it, in order, and executes a call once. So it sends
S_EXECUTING only for the first attempt that reached it.

A client that names the previous attempt may name one that was not captured. Its retry may then be the first
captured request of another call. A world may join both. In such a joined world, the oracle uses neither the
longest wait nor that a call is executed once: the package decides about the first part before it knows how
the second one ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
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
SILENCE = 50 * MS
SILENT_WAITS = 4

Times = tuple[int | None, ...]
NOWHERE: Times = (None,)


class Claim(Enum):
    """What may be true of a call. Several claims may be true at once."""

    REQUEST_LOST = "request lost"
    REPLY_LOST = "reply lost"
    REPLY_LATE = "reply late"
    UNANSWERED = "unanswered"
    WAITING = "waiting"


class Fate(Enum):
    """What became of an attempt."""

    REQUEST_LOST = 1
    REPLY_LOST = 2
    REPLY_LATE = 3
    ACCEPTED = 4
    NO_REPLY_YET = 5


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


@dataclass(frozen=True)
class World:
    """A course of a call that gives the same capture."""

    claims: frozenset[Claim]
    accepted: int | None


def follower(serial: int) -> int:
    return serial % 0xFFFF + 1


def later(before: int, after: int) -> bool:
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
        found = set()
        if all(sent.reserved == sent.serial for sent in firsts) and all(sent.is_first for sent in origins):
            found.add("own")
        if all(sent.reserved == 0 for sent in firsts):
            found |= {"seed"} if all(sent.is_first for sent in origins) else set()
            found |= {"chain"} if all(follower(sent.reserved) == sent.serial for sent in retries) else set()
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
            self._is_hasty(before, after) and not self.replies.get(before.serial, self.unseen)[0]
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

    def courses(self, index: int) -> Iterator[Course]:
        """Yield each way in which a captured request and its neighbours may form a call."""
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

    def _is_hasty(self, before: Sent, after: Sent) -> bool:
        """Return whether a call began so soon after a request, or S_EXECUTING for it, that its client may not
        wait for replies."""
        notices = [time for time in self.noticed.get(before.serial, ()) if time < after.near]
        return after.near - max([before.near, *notices]) < SHORTEST_TIMEOUT

    # fates

    def fates(self, course: Course, number: int) -> Iterator[Fate]:
        """Yield what may have become of an attempt, as far as the places of capture allow."""
        attempt, is_last = course.attempts[number], number == len(course.attempts) - 1
        is_answered, is_sent = any(attempt.reply), any(attempt.request)
        was_lost_between = is_sent and not all(attempt.request)
        is_delivered = is_answered and all(attempt.reply)
        if is_delivered and is_last:
            yield Fate.ACCEPTED
        if not (is_answered or was_lost_between) and not any(
            later(attempt.serial, serial) for serial in self.replies
        ):
            yield Fate.NO_REPLY_YET
        if is_delivered:
            yield Fate.REPLY_LATE
        if not was_lost_between and (is_answered or self.place != "controller"):
            yield Fate.REPLY_LOST
        if not (is_answered or attempt.is_noticed) and not (is_sent and self.place == "controller"):
            yield Fate.REQUEST_LOST

    def told(self, serial: int) -> str:
        """Describe a captured request and the ones after it, for the message of a failed test."""
        index = self._index(serial)
        return " ".join(
            f"{sent.serial}/{sent.reserved} {sent.times}" for sent in self.requests[index : index + 5]
        )

    def _index(self, serial: int) -> int:
        return next(index for index, sent in enumerate(self.requests) if sent.serial == serial)

    def worlds(self, serial: int, without: Claim | None = None) -> Iterator[World]:
        """Yield the possible worlds of the call of a captured request, which has the serial `serial`.

        `without` leaves out the worlds in which a claim is true.
        """
        round_trip, wait = self.longest_round_trip(), self.longest_wait()
        excluded = without and Fate.__members__.get(without.name)
        for course in self.courses(self._index(serial)):
            choices = [
                [fate for fate in self.fates(course, number) if fate is not excluded]
                for number in range(len(course.attempts))
            ]
            for fates in product(*choices):
                if not keeps_order(course, fates) or not have_times(course, fates, round_trip, wait):
                    continue
                is_accepted = fates[-1] is Fate.ACCEPTED
                claims = claims_of(course, fates)
                for ending in [set()] if is_accepted else self._endings(course):
                    if without not in claims | ending:
                        accepted = course.attempts[-1].serial if is_accepted else None
                        yield World(frozenset(claims | ending), accepted)

    def _endings(self, course: Course) -> list[set[Claim]]:
        """Return what the client may do at the end of the capture, if it has accepted no reply.

        A client that has sent nothing else waits four times as long as between its attempts.
        """
        endings = [{Claim.UNANSWERED}]
        times = [time for attempt in course.attempts if (time := attempt.request[0]) is not None]
        if course.is_hasty or (course.next_at is None and (len(times) < 2 or any(self._noticed(course)))):
            return [*endings, {Claim.WAITING}]
        if course.next_at is None:
            silence = max(SILENT_WAITS * (times[-1] - times[0]), SILENCE)
            endings += [{Claim.WAITING}] if self.ended - times[-1] <= silence else []
        return endings

    def _noticed(self, course: Course) -> Iterator[bool]:
        return (attempt.is_noticed for attempt in course.attempts)


def keeps_order(course: Course, fates: Sequence[Fate]) -> bool:
    """Return whether the controller sends S_EXECUTING only for the first attempt that reaches it."""
    return course.is_joined or all(
        fate is Fate.REQUEST_LOST
        for number, attempt in enumerate(course.attempts)
        if attempt.is_noticed
        for fate in fates[:number]
    )


def claims_of(course: Course, fates: Sequence[Fate]) -> set[Claim]:
    """Return what is true of the attempts of a course."""
    found = {Claim[fate.name] for fate in fates if fate.name in Claim.__members__}
    nexts = [attempt.request[0] for attempt in course.attempts[1:]]
    nexts.append(None if course.is_hasty else course.next_at)
    for attempt, fate, next_at in zip(course.attempts, fates, nexts, strict=True):
        passed = attempt.reply[0]
        if fate is Fate.REPLY_LOST and passed is not None and next_at is not None and passed >= next_at:
            found.add(Claim.REPLY_LATE)
    return found


def have_times(course: Course, fates: Sequence[Fate], round_trip: int, wait: int) -> bool:
    """Return whether times of sending and of arrival exist with which attempts fare like this."""
    bounds = Bounds()
    attempts = course.attempts
    sent = [f"sent {number}" for number in range(len(attempts))]
    passed = [attempt.request[0] for attempt in attempts]
    sent.append("next")
    passed.append(course.next_at)
    for number, time in enumerate(passed):
        if number:
            bounds.at_most(sent[number - 1], sent[number], -1)
        if time is not None:
            bounds.at_most(sent[number], "", time)
            bounds.at_most("", sent[number], round_trip - time)
    for number, (attempt, fate) in enumerate(zip(attempts, fates, strict=True)):
        reply = attempt.reply[0]
        if fate not in (Fate.ACCEPTED, Fate.REPLY_LATE):
            continue
        assert reply is not None
        came = f"came {number}"
        bounds.at_most("", came, -reply)
        for other, time in zip(sent, passed, strict=True):
            if time is not None:
                bounds.at_most(came, other, round_trip + reply - time)
        if fate is Fate.ACCEPTED:
            if not course.is_hasty:
                bounds.at_most(came, "next", 0)
            if not course.is_joined and not any(each.is_noticed for each in attempts):
                bounds.at_most(came, sent[number], wait)
        elif number < len(attempts) - 1:
            bounds.at_most(sent[number + 1], came, SLACK)
    return bounds.hold()


class Bounds:
    """Bounds on differences of times: a system that has a solution unless a cycle of bounds is negative."""

    def __init__(self) -> None:
        self._bounds: dict[tuple[str, str], int] = {}

    def at_most(self, later: str, earlier: str, bound: int) -> None:
        """Demand later - earlier <= bound; "" is the time 0."""
        key = earlier, later
        self._bounds[key] = min(bound, self._bounds.get(key, bound))

    def hold(self) -> bool:
        """Return whether times exist that keep all bounds (Bellman and Ford)."""
        distance: dict[str, int] = {name: 0 for key in self._bounds for name in key}
        for _ in range(len(distance) + 1):
            changed = False
            for (earlier, later), bound in self._bounds.items():
                if distance[earlier] + bound < distance[later]:
                    distance[later] = distance[earlier] + bound
                    changed = True
            if not changed:
                return True
        return False
