"""Facts about a conversation in two captures, known before the captures are joined."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import Coverage


class CapturedTwins:
    """One conversation that was captured at two places, with two captures.

    Objects of this class are compared by identity.

    Attributes:
        coverage: When the captures at the client's and at the controller's side began and ended.
        clock_error: Uncertainty of the difference between the clocks of both captures, ns.
        is_relayed: Whether a proxy is between the places.
    """

    def __init__(self, coverage: tuple[Coverage, Coverage], clock_error: int, *, is_relayed: bool) -> None:
        self.coverage = coverage
        self.clock_error = clock_error
        self.is_relayed = is_relayed


class CaptureSide(NamedTuple):
    """Place at which a conversation was captured, if another capture holds the same conversation."""

    twins: CapturedTwins
    place: CapturePlace
