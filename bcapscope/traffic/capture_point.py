"""Where a capture was taken, and what this means for replies that were captured shortly before a retry.

If the client sends a retry before it receives a reply, retry and reply cross, and the reply is late. If the
reply had enough time to reach the client, and the client still retried, the reply was lost. Only a capture on
the client's computer shows whether the reply was late or lost. A capture from any other place shows only
whether a reply and a retry may have crossed. The capture times of such a reply and retry differ by at most
the round-trip time between the place of the capture and the client.
"""

from __future__ import annotations

from bisect import insort
from enum import StrEnum
from typing import TYPE_CHECKING

from bcapscope.traffic.unseen_attempts import skipped_serials

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, FrameObservation

CROSSING_AT_CLIENT_NS = 500_000
"""Maximum time in ns from a reply to a retry that crossed this reply, in a capture on the client's computer.
The client began to send the retry before it received the reply.
"""

LONGEST_ROUND_TRIP_NS = 100_000_000
"""Longest assumed round trip in ns from the capture point to the client. In a factory network, a round trip
takes milliseconds.
"""

# The estimate of the round trip needs this number of reaction times, because a single short reaction time can
# be a coincidence.
_REACTIONS = 3
_MARGIN = 2  # a round trip may take this many times as long as the shortest reaction times


class CapturePoint(StrEnum):
    """Where a capture was taken."""

    CLIENT = "client"
    """On the client's computer."""
    CONTROLLER = "controller"
    """At the controller, such as on a mirror port next to it."""
    BETWEEN = "between"
    """Between client and controller."""


class CrossingWindow:
    """The time within which a reply and a retry of one client may cross.

    A client's reaction time is the time from the capture of a reply to the capture of the next request. This
    time includes the round trip between capture point and client. `CrossingWindow` uses only reaction times
    below `considered_below_ns`.
    """

    def __init__(self, taken_at: CapturePoint | None = None) -> None:
        self.considered_below_ns = 0 if taken_at is CapturePoint.CLIENT else LONGEST_ROUND_TRIP_NS
        self._taken_at = taken_at
        self._shortest: list[int] = []

    def add_reaction(self, nanoseconds: int) -> None:
        insort(self._shortest, max(nanoseconds, 0))
        if len(self._shortest) >= _REACTIONS:
            del self._shortest[_REACTIONS:]
            self.considered_below_ns = self._shortest[-1]

    def add_answered_call(self, call: Call, following: FrameObservation) -> None:
        """Add the client's reaction time from the reply to `call` until the client's next request,
        `following`. Ignore a retried call, because the reply to a retried call may be late.
        """
        is_retried = not call.first_attempt_seen or call.last_attempt is not call.request
        if (
            call.reply is None
            or is_retried
            or skipped_serials(call.request.item.serial, following.item.serial)
        ):
            return
        reaction = following.time - call.reply.time
        if reaction < self.considered_below_ns:
            self.add_reaction(reaction)

    def ignore_reactions(self) -> None:
        """Ignore the client's reaction times, because the client does not wait for replies."""
        self.considered_below_ns = 0
        self._shortest.clear()

    def settle(self, call: Call) -> None:
        call.crossing_ns = self.nanoseconds
        call.is_at_controller = self._taken_at is CapturePoint.CONTROLLER

    @property
    def nanoseconds(self) -> int:
        """Maximum time in ns between a reply and a retry that may have crossed each other on the network."""
        if self._taken_at is CapturePoint.CLIENT:
            return CROSSING_AT_CLIENT_NS
        if len(self._shortest) < _REACTIONS:
            return LONGEST_ROUND_TRIP_NS
        return min(_MARGIN * self._shortest[-1] + CROSSING_AT_CLIENT_NS, LONGEST_ROUND_TRIP_NS)
