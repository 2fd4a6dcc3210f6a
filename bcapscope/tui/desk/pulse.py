"""Whether the controller is still there, as far as what comes from it tells."""

from __future__ import annotations

PATIENCE = 1_500_000_000
"""Nanoseconds for which an answer may be owed: longer than any other call than a motion takes."""


class Pulse:
    """When the controller was heard last, on any of the lines to it, and whether it owes an answer.

    What is sent and received tells, in any thread; times are ns of one clock. Where nothing is asked, nothing
    is known: a silence counts only from a request on.
    """

    def __init__(self, now: int) -> None:
        """Begin with a controller that was asked nothing yet."""
        self._heard = now
        self._asked = 0

    def asked(self, now: int) -> None:
        """Take notice of a request; what is asked once more is owed since the first time."""
        self._asked = self._asked or now

    def heard(self, now: int) -> None:
        """Take notice of anything that came."""
        self._heard, self._asked = now, 0

    def age(self, now: int) -> int:
        """Return for how long nothing has come."""
        return now - self._heard

    def is_silent(self, now: int) -> bool:
        """Tell whether an answer is owed for longer than it should take."""
        asked = self._asked
        return asked > 0 and now - asked > PATIENCE
