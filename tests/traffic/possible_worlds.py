"""Every course of a call that gives the same capture: an oracle for "cannot tell".

The oracle reads only what was captured. It shares no code with the package's pairing. It takes each choice
that the capture leaves open, and checks whether true times exist that fit: times of sending and of arrival,
as a system of difference constraints.

What the worlds of one session share, because it is a fact about the client, the network or the capture:

- The convention of the reserved field. A world may have any convention that the captured requests fit. Only
  a retry that names a captured attempt shows whether the client names the previous one.
- The place of capture, if it was named. At the controller, nothing is lost behind the capture. If the place
  was not named, it is on the way, and frames are lost before and behind it.
- The longest round trip from the capture to the client and back: twice that which the client's reactions
  show, 99.5 ms if there are none. Two reactions may be a coincidence, so the third-shortest counts. A
  reaction counts only after a call of a single attempt, if no serial was skipped before the next request,
  and only if the client waits for replies (see below).
- The longest wait for a reply: twice the longest distance between two attempts. It is known for a call with
  several captured attempts and without S_EXECUTING.

What is free in each world and call:

- The capture lacks any request without notice, but no reply. Two captures lack a request both or not at all.
- Each request and each reply is lost or not, before, between or behind the places. A reply that has reached
  the client's computer may still be lost there. A client that already prepares a retry does not read a reply
  for up to 0.5 ms.
- The number of attempts and the client's pauses. A client that begins a call within 2 ms after a request, or
  after S_EXECUTING, may still accept the reply to the call before.

A frame that only one of two places has may have passed the other one as well, if it is one of the last:
within 1 s before the end, with no later frame of its direction at both. The other capture may have ended
before.

The controller answers each attempt that reaches it, in order, and executes a call once. So it sends
S_EXECUTING only for the first attempt that reached it.

A client that names the previous attempt may name one that was not captured. Its retry may then be the first
captured request of another call. A world may join both. In such a joined world, the oracle uses neither the
longest wait nor that a call is executed once: the package decides about the first part before it knows how
the second one ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

from tests.traffic.capture_evidence import SLACK, Course, Evidence, is_later
from tests.traffic.captured_sessions import MS

SILENCE = 50 * MS
SILENT_WAITS = 4


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


TIMED = (Fate.ACCEPTED, Fate.REPLY_LATE)
"""The fates of attempts whose reply reached the client."""


@dataclass(frozen=True)
class World:
    """A course of a call that gives the same capture."""

    claims: frozenset[Claim]
    accepted: int | None


class PossibleWorlds:
    """The worlds that give a capture."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._round_trip = evidence.longest_round_trip()
        self._wait = evidence.longest_wait()

    def _fates(self, course: Course, number: int) -> Iterator[Fate]:
        """Yield what may have become of an attempt, as far as the places of capture allow."""
        attempt, is_last = course.attempts[number], number == len(course.attempts) - 1
        is_answered, is_sent = any(attempt.reply), any(attempt.request)
        was_lost_between = is_sent and not all(attempt.request)
        is_delivered = is_answered and all(attempt.reply)
        if is_delivered and is_last:
            yield Fate.ACCEPTED
        if not (is_answered or was_lost_between) and not any(
            is_later(attempt.serial, serial) for serial in self._evidence.replies
        ):
            yield Fate.NO_REPLY_YET
        if is_delivered:
            yield Fate.REPLY_LATE
        if not was_lost_between and (is_answered or self._evidence.place != "controller"):
            yield Fate.REPLY_LOST
        if not (is_answered or attempt.is_noticed) and not (is_sent and self._evidence.place == "controller"):
            yield Fate.REQUEST_LOST

    def worlds(self, serial: int, without: Claim | None = None) -> Iterator[World]:
        """Yield the possible worlds of the call of a captured request, which has the serial `serial`.

        `without` leaves out the worlds in which a claim is true.
        """
        excluded = without and Fate.__members__.get(without.name)
        for course in self._evidence.courses(serial):
            choices = [
                [fate for fate in self._fates(course, number) if fate is not excluded]
                for number in range(len(course.attempts))
            ]
            are_possible: dict[tuple[Fate | None, ...], bool] = {}  # by the fates that matter to the times
            for fates in product(*choices):
                claims = claims_of(course, fates)
                if without in claims or not keeps_order(course, fates):
                    continue
                timed = tuple(fate if fate in TIMED else None for fate in fates)
                if timed not in are_possible:
                    are_possible[timed] = have_times(course, fates, self._round_trip, self._wait)
                if not are_possible[timed]:
                    continue
                is_accepted = fates[-1] is Fate.ACCEPTED
                for ending in [set()] if is_accepted else self._endings(course):
                    if without not in ending:
                        accepted = course.attempts[-1].serial if is_accepted else None
                        yield World(frozenset(claims | ending), accepted)

    def _endings(self, course: Course) -> list[set[Claim]]:
        """Return what the client may do at the end of the capture, if it has accepted no reply.

        A client that has sent nothing else waits four times as long as between its attempts.
        """
        endings = [{Claim.UNANSWERED}]
        times = [time for attempt in course.attempts if (time := attempt.request[0]) is not None]
        if course.is_hasty or (
            course.next_at is None and (len(times) < 2 or any(each.is_noticed for each in course.attempts))
        ):
            return [*endings, {Claim.WAITING}]
        if course.next_at is None:
            silence = max(SILENT_WAITS * (times[-1] - times[0]), SILENCE)
            endings += [{Claim.WAITING}] if self._evidence.ended - times[-1] <= silence else []
        return endings


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
        if fate not in TIMED:
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
            is_retried = sum(any(each.request) for each in attempts) > 1
            if is_retried and not course.is_joined and not any(each.is_noticed for each in attempts):
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
